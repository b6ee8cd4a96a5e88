"""Acting, also at random: the transitions that one update learns from, and whether they are finite."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, cast

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Int, Shaped

from core.algorithms.algorithm import Failure
from core.algorithms.brax_training import Transition
from core.algorithms.evaluation import Policy, clearly_named
from core.algorithms.lost_body import Steps, first_lost
from core.algorithms.sharding import ONE_DEVICE, Sharding
from core.algorithms.spec import EpsilonShape
from core.environments.body_position import body_position
from core.environments.environment import Environment, State
from core.environments.wrappers.autoreset import Episodes, draw, follow, fresh_pool, without_lost
from core.environments.wrappers.clip_parts import parts_reached
from core.environments.wrappers.terrain_levels import chosen_starts
from core.environments.wrappers.vectorized import VectorEnv
from core.physics.engine import overflowed

# The share of an update's steps that may lose a body; a run that loses more has diverged.
_MOST_LOST = 0.01

# One number for each of N environments, at one step or at each of T.
PerStep = Float[Array, "*T N"]
Scalar = Float[Array, ""] | float


@struct.dataclass
class Starts:
    """The initial states of the episodes that follow ended ones.

    pool: fresh initial states [K, ...]. chosen: [num_steps, num_envs] int32, which of them an
    environment gets if its episode ends at that step; on a terrain with levels, which of those of its level.
    """

    pool: State
    chosen: Int[Array, "num_steps num_envs"]

    def after(self, environment: Environment, reached: State, chosen: Int[Array, " num_envs"]) -> State:
        """The states [num_envs, ...] from which environments restart that ended in the states `reached`."""
        return draw(self.pool, chosen_starts(environment, reached, chosen, len(self.pool.reward)))


@struct.dataclass
class StepOutcomes:
    """The experience of T steps in N environments; arrays [T, N].

    fell: 1 where the episode ended, though not by its length. lost: of these, 1 where the body's state was
    lost (`without_lost`). effort: mean square of the action's components. metrics: the environment's own, by
    name, and its body's position. overflow: 1 where the engine had no room for all contacts. steps: for the
    last states of a lost body. parts: of clips, which the steps came to, for a record of where they fail.
    """

    reward: PerStep
    ended_length: Int[Array, "*T N"]
    ended_score: PerStep
    fell: PerStep
    lost: PerStep
    effort: PerStep
    metrics: Mapping[str, PerStep]
    overflow: PerStep
    steps: Steps | None = None
    parts: Int[Array, "*T N"] | None = None


def drawn_starts(
    envs: VectorEnv, key: jax.Array, shape: tuple[int, int], pool_size: int, sharding: Sharding = ONE_DEVICE
) -> Starts | None:
    """Initial states of one update's episodes: drawn from its key, so that no state has to hold them.

    shape: (num_steps, num_envs). pool_size: 0: every environment returns to its own first state, and there
    are none.
    """
    if not pool_size:
        return None
    pool_key, choose_key = jax.random.split(key)
    return Starts(
        pool=sharding.everywhere(fresh_pool(envs, pool_key, pool_size)),
        chosen=sharding.split(jax.random.randint(choose_key, shape, 0, pool_size), axis=1),
    )


def collect(  # noqa: PLR0913 - all but three are named
    envs: VectorEnv,
    policy: Policy,
    episodes: Episodes,
    keys: jax.Array,
    *,
    episode_length: int,
    starts: Starts | None = None,
    seen: Callable[[State], Any] = lambda state: state.obs,
) -> tuple[Episodes, tuple[Transition, StepOutcomes]]:
    """Act once with each of the keys [num_steps, ...]; the results' first axes are [num_steps, num_envs].

    starts: None if every environment returns to its own first state, which `episodes` then holds. seen: what
    the policy is given of states, and what a transition has as its observation.
    """
    where = jax.vmap(body_position(envs.environment.model, envs.environment.tracked_body))

    def act(episodes: Episodes, step_inputs: Any) -> tuple[Episodes, tuple[Transition, StepOutcomes]]:
        key, chosen = step_inputs
        observation = seen(episodes.state)
        action, extras = policy(observation, key)
        moved = envs.step(episodes.state, action)
        reached, lost = without_lost(episodes.state, moved)
        fresh = None if starts is None else starts.after(envs.environment, reached, chosen)
        after = follow(episodes, reached, fresh, episode_length=episode_length)
        transition = Transition(
            observation=observation,
            action=(),  # pyright: ignore[reportArgumentType]
            reward=after.state.reward,
            discount=1 - after.state.done,
            next_observation=after.state.obs,
            extras=cast("Any", {"policy_extras": extras, "state_extras": {"truncation": after.truncated}}),
        )
        outcome = StepOutcomes(
            reward=after.state.reward,
            ended_length=after.ended_length,
            ended_score=after.ended_score,
            fell=after.state.done - after.truncated,
            lost=lost.astype(jnp.float32),
            effort=jnp.mean(jnp.square(action), axis=-1),
            metrics={**where(reached.physics), **reached.metrics},
            overflow=overflowed(moved.physics),
            steps=Steps.of(episodes.state, action, after.state.reward, after.state.done),
            parts=parts_reached(envs.environment, reached),
        )
        return after, (transition, outcome)

    chosen = None if starts is None else starts.chosen
    return jax.lax.scan(act, episodes, (keys, chosen))


def cut_into_unrolls(transitions: Transition, unroll_length: int) -> Transition:
    """From [T, N, ...] to [T / unroll_length * N, unroll_length, ...], as Brax's loss takes it.

    Only the last of an unroll's next observations is kept, [.., 1, ...]: the loss reads no other.
    """

    def cut(x: Shaped[Array, "T N ..."]) -> Shaped[Array, "B unroll ..."]:
        unrolls = x.reshape((-1, unroll_length, *x.shape[1:])).swapaxes(1, 2)
        return unrolls.reshape((-1, unroll_length, *x.shape[2:]))

    batch: Transition = jax.tree.map(cut, transitions)
    last = jax.tree.map(lambda x: x[:, -1:], batch.next_observation)
    return batch._replace(next_observation=last)


def bootstrap_timeouts(transitions: Transition, discounting: Scalar, reward_scaling: Scalar) -> Transition:
    """Turn transitions that cut an episode off into terminations whose reward is higher by γ V(s).

    The value of the step's own observation stands in for that of the next one, as in RSL-RL. Values are in
    units of scaled reward; the loss scales all rewards, so they are divided by the scale here.
    Source: Rudin et al., Learning to Walk in Minutes (2022), section 3.2; Brax's `bootstrap_on_timeout`.
    """
    extras = cast("dict[str, Any]", transitions.extras)
    timeout = extras["state_extras"]["truncation"]
    worth = discounting * extras["policy_extras"]["value"] / reward_scaling
    return transitions._replace(
        reward=transitions.reward + timeout * worth,
        extras=cast("Any", {**extras, "state_extras": {"truncation": jnp.zeros_like(timeout)}}),
    )


def of_whole_episodes(outcome: StepOutcomes, actions_before: Int[Array, ""]) -> StepOutcomes:
    """The outcome without the ends of episodes that, judged by their length, began before the run.

    actions_before: [] int32, how often every environment had acted before.
    """
    acted = actions_before + 1 + jnp.arange(len(outcome.reward))[:, None]
    whole = outcome.ended_length <= acted

    def keep(of_an_end: Shaped[Array, "T N"]) -> Shaped[Array, "T N"]:
        return jnp.where(whole, of_an_end, 0)

    return replace(
        outcome,
        ended_length=keep(outcome.ended_length),
        ended_score=keep(outcome.ended_score),
        fell=keep(outcome.fell),
    )


def lost_too_many(outcome: StepOutcomes) -> Bool[Array, " T"]:
    """The time steps that lost a body, if more than one did, and more than `_MOST_LOST` of all; else none."""
    most = max(1.0, _MOST_LOST * outcome.lost.size)
    return jnp.any(outcome.lost > 0, axis=1) & (jnp.sum(outcome.lost) > most)


def summarise(outcome: StepOutcomes) -> dict[str, Float[Array, ""]]:
    """Sums over one update, [] float32: finished episodes, their scores and lengths, and how many fell.

    Also means over its steps: the control effort, every metric of the environment by its own name (the speed
    by a clearer one), the share of steps that lost a body, and of those in which the engine lost contacts.
    """
    means = clearly_named(outcome.metrics) | {
        "control_effort": outcome.effort,
        "lost_bodies": outcome.lost,
        "physics_overflow": outcome.overflow,
    }
    sums = {
        "episodes": jnp.sum(outcome.ended_length > 0).astype(jnp.float32),
        "score": jnp.sum(outcome.ended_score),
        "length": jnp.sum(outcome.ended_length).astype(jnp.float32),
        "falls": jnp.sum(outcome.fell),
    }
    return {name: jnp.mean(values) for name, values in means.items()} | sums


def training_metrics(sums: Mapping[str, Any], num_updates: int, action_repeat: int) -> dict[str, float]:
    """Means over an epoch, under Brax's names. Lengths count environment steps."""
    values = {name: float(value) for name, value in sums.items()}
    episodes, score, length, falls = (values.pop(name) for name in ("episodes", "score", "length", "falls"))
    metrics = {f"training/{name}": value / num_updates for name, value in values.items()}
    if episodes:
        metrics["training/episode_reward"] = score / episodes
        metrics["training/episode_length"] = length / episodes * action_repeat
        metrics["training/fall_rate"] = falls / episodes
    return metrics


def greedy(values: Float[Array, "*N choices"]) -> Int[Array, "*N"]:
    """The best choices [...] int32 by their values, of equal ones the first."""
    return jnp.argmax(values, axis=-1).astype(jnp.int32)


def epsilon_greedy(values: Float[Array, "*N choices"], epsilon: Scalar, key: jax.Array) -> Int[Array, "*N"]:
    """The best choices [...] int32, but with probability epsilon [] any.

    Source: Sutton & Barto, Reinforcement Learning (2018), section 2.2.
    """
    explore_key, choose_key = jax.random.split(key)
    shape, num_choices = values.shape[:-1], values.shape[-1]
    explores = jax.random.uniform(explore_key, shape) < epsilon
    any_choice = jax.random.randint(choose_key, shape, 0, num_choices)
    return jnp.where(explores, any_choice, greedy(values))


def decayed(
    start: Float[Array, "*#A"] | float, end: Float[Array, "*#A"] | float, share: Scalar, shape: EpsilonShape
) -> Float[Array, "*#A"]:
    """Epsilon after this share of its decay, which ends at 1: from `start` to `end`, for each agent A."""
    share = jnp.clip(share, 0.0, 1.0)
    if shape == "linear":
        return start + (end - start) * share
    return start * (end / start) ** share


def find_failure(next_observation: Any, outcome: StepOutcomes, learnt: Sequence[jax.Array]) -> Failure:
    """Which quantities of an update were not finite. Each may spoil those after it.

    next_observation: arrays [T, N, size]. learnt: for each further quantity, [] bool, true where it is not
    finite.
    """
    seen = [jnp.all(jnp.isfinite(x), axis=(1, 2)) for x in jax.tree.leaves(next_observation)]
    bad_obs = ~jnp.all(jnp.stack(seen), axis=0) | lost_too_many(outcome)
    bad_reward = ~jnp.all(jnp.isfinite(outcome.reward), axis=1)
    bad = bad_obs | bad_reward
    first = jnp.where(jnp.any(bad), jnp.argmax(bad), len(bad)).astype(jnp.int32)
    lost = None if outcome.steps is None else first_lost(outcome.steps, outcome.lost)
    return Failure(jnp.stack([jnp.any(bad_obs), jnp.any(bad_reward), *learnt]), first, lost)


def any_not_finite(tree: Any) -> jax.Array:
    """[] bool, of all arrays of a tree."""
    return jnp.any(jnp.stack([~jnp.all(jnp.isfinite(x)) for x in jax.tree.leaves(tree)]))
