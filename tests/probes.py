"""Environments so small that their right answer is known: each isolates one thing a learner must do.

Source: Andy Jones, "Debugging reinforcement learning systems" (2021), probe environments.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import jax
import jax.numpy as jnp
import mujoco

from core.environments.environment import CONTINUOUS, Discretization, State
from core.physics.engine import NOMINAL, ModelFields, PhysicsState

# (observation, time, action) -> (reward, done)
Rule = Callable[[jax.Array, jax.Array, jax.Array], tuple[jax.Array, jax.Array]]


@dataclass(frozen=True)
class Probe:
    """An environment without physics: one number is seen, one is acted, `rule` says what it brings.

    random_sign: the first observation is -1 or +1, else 0. shows_time: every later one is the number of
    actions taken.
    """

    rule: Rule
    random_sign: bool = False
    shows_time: bool = False
    observation_size: int = 1
    action_size: int = 1
    dt: float = 1.0
    episode_length: int = 8
    tracked_body: int = 0
    discretization: Discretization = CONTINUOUS

    @cached_property
    def model(self) -> mujoco.MjModel:
        return mujoco.MjModel.from_xml_string("<mujoco/>")

    def reset(self, key: jax.Array, model: ModelFields = NOMINAL) -> State:
        sign = jnp.where(jax.random.bernoulli(key), 1.0, -1.0)
        obs = jnp.where(self.random_sign, sign, 0.0)[None]
        zero = jnp.zeros(())
        return State(nowhere(model), obs, zero, zero, metrics={"x_velocity": zero}, info={})

    def step(self, state: State, action: jax.Array) -> State:
        reward, done = self.rule(state.obs[0], state.physics.time, action[0])
        time = state.physics.time + self.dt
        return replace(
            state,
            physics=replace(state.physics, time=time),
            obs=time[None] if self.shows_time else state.obs,
            reward=reward,
            done=done,
            metrics={"x_velocity": action[0]},
        )


def nowhere(model: ModelFields) -> PhysicsState:
    """The state of a model without joints, at time 0."""
    nothing = jnp.zeros(0)
    return PhysicsState(nothing, nothing, nothing, nothing, jnp.zeros(()), {}, model)


def constant_reward() -> Probe:
    """One step, always 1: the value of the only observation is 1."""
    return Probe(lambda obs, time, action: (jnp.ones(()), jnp.ones(())))


def observed_reward() -> Probe:
    """One step, the reward is the observation (-1 or 1): the value must look at it."""
    return Probe(lambda obs, time, action: (obs, jnp.ones(())), random_sign=True)


def delayed_reward() -> Probe:
    """Two steps, 1 at the second: the first value is the discount."""
    return Probe(lambda obs, time, action: (time, time), shows_time=True)


def action_reward() -> Probe:
    """One step, the reward falls with the distance of the action from 0.5."""
    return Probe(lambda obs, time, action: (-((action - 0.5) ** 2), jnp.ones(())))


def observed_action_reward() -> Probe:
    """One step, the best action is half the observation: the policy must look at it."""
    return Probe(lambda obs, time, action: (-((action - 0.5 * obs) ** 2), jnp.ones(())), random_sign=True)


@dataclass(frozen=True)
class IntentionProbe(Probe):
    """Two numbers are seen, -1 or +1 each: what is wanted, and the body. The best action is 0.5 times the
    first plus 0.4 times the second, so that who sees only one of them misses it by 0.4 or more."""

    observation_size: int = 2

    def reset(self, key: jax.Array, model: ModelFields = NOMINAL) -> State:
        signs = jnp.where(jax.random.bernoulli(key, shape=(2,)), 1.0, -1.0)
        return replace(super().reset(key, model), obs=signs)

    def step(self, state: State, action: jax.Array) -> State:
        wanted = 0.5 * state.obs[0] + 0.4 * state.obs[1]
        return replace(super().step(state, action), reward=-((action[0] - wanted) ** 2), obs=state.obs)


def intention() -> IntentionProbe:
    return IntentionProbe(lambda obs, time, action: (obs, jnp.ones(())))


def unending_reward(reward: float = 1.0) -> Probe:
    """The same reward at every step, and no step ends it: the value is reward / (1 - discount)."""
    return Probe(lambda obs, time, action: (jnp.float32(reward), jnp.zeros(())))


def endless() -> Probe:
    """No step ends it: episodes are only ever cut off. The reward is the action."""
    return Probe(lambda obs, time, action: (action, jnp.zeros(())), shows_time=True)


def exploding(after: int) -> Probe:
    """The reward is not a number from the step on that follows `after` actions of an episode."""
    return Probe(
        lambda obs, time, action: (jnp.where(time >= after, jnp.nan, 1.0), jnp.zeros(())),
        shows_time=True,
        episode_length=10**6,
    )


@dataclass(frozen=True)
class LosingProbe(Probe):
    """The reward is 1, and no step ends it. Each body has a number between 0 and 1, which it observes; the
    state of one whose number is below `share` is lost in the step that follows `after` actions."""

    share: float = 0.0
    after: int = 0

    def reset(self, key: jax.Array, model: ModelFields = NOMINAL) -> State:
        return replace(super().reset(key, model), obs=jax.random.uniform(key, (1,)))

    def step(self, state: State, action: jax.Array) -> State:
        lost = (state.obs < self.share) & (state.physics.time >= self.after)
        after = super().step(state, action)
        return replace(after, obs=jnp.where(lost, jnp.nan, state.obs))


def losing(share: float, after: int) -> LosingProbe:
    return LosingProbe(
        lambda obs, time, action: (jnp.ones(()), jnp.zeros(())),
        episode_length=10**6,
        share=share,
        after=after,
    )


@dataclass(frozen=True)
class GrowingProbe(Probe):
    """No step ends it. `info["begun_at"]` is the progress of the curriculum at which its episode began."""

    curriculum_steps: int = 1
    progress: jax.Array | float = 1.0

    def at_progress(self, progress: jax.Array) -> "GrowingProbe":
        return replace(self, progress=progress)

    def reset(self, key: jax.Array, model: ModelFields = NOMINAL) -> State:
        begun_at = jnp.asarray(self.progress, jnp.float32)
        return replace(super().reset(key, model), info={"begun_at": begun_at})


def growing(curriculum_steps: int) -> GrowingProbe:
    """A curriculum over this number of environment steps. The reward is the action."""
    return GrowingProbe(
        lambda obs, time, action: (action, jnp.zeros(())), random_sign=True, curriculum_steps=curriculum_steps
    )
