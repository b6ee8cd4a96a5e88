"""The base of our environments: a model, an engine that steps it, and its sizes."""

import copy
import operator
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from functools import reduce
from types import MappingProxyType
from typing import Self

import jax
import jax.numpy as jnp
import mujoco

from core.environments.environment import (
    CONTINUOUS,
    Discretization,
    Observation,
    ObservationSize,
    State,
)
from core.environments.simulated_model import NotSimulated
from core.environments.simulation import Simulation
from core.physics.engine import NOMINAL, Engine, ModelFields, PhysicsState
from core.physics.model import initial_qpos


class MujocoEnv(ABC):
    """An environment over one MuJoCo model; a subclass defines its start, observation and reward.

    reports_rewards: whether each term of the reward is also a metric. aliases: further metrics that repeat a
    term of the reward, each with the name of that term; of a task without it there is none.
    """

    episode_length = 1000
    discretization: Discretization = CONTINUOUS
    reports_rewards: bool = True
    aliases: Mapping[str, str] = MappingProxyType({})

    def __init__(
        self,
        model: mujoco.MjModel,
        engine: Engine,
        *,
        num_substeps: int,
        observation_size: int,
        tracked_body: str | int,
    ) -> None:
        self.model = model
        self.engine = engine
        self.dt = model.opt.timestep * num_substeps
        self.observation_size: ObservationSize = observation_size
        self.action_size: int = model.nu
        self.tracked_body: int = model.body(tracked_body).id
        self.initial_qpos = jnp.asarray(initial_qpos(model), jnp.float32)
        # Where an episode does not begin at rest: velocities [nv], and states of actuators [na].
        self.initial_qvel: jax.Array | None = None
        self.initial_act: jax.Array | None = None

    @abstractmethod
    def reset(self, key: jax.Array, model: ModelFields = NOMINAL) -> State: ...

    @abstractmethod
    def step(self, state: State, action: jax.Array) -> State: ...

    def placed(self, key: jax.Array, qpos: jax.Array, qvel: jax.Array) -> tuple[jax.Array, jax.Array]:
        """The positions [nq] and velocities [nv] at which an episode begins, from those with noise. key: of
        the episode's reset."""
        return qpos, qvel

    def simulation(self) -> Simulation:
        """The data with which a program steps this body by MuJoCo alone. Raises NotSimulated."""
        raise NotSimulated("its model is made for each training")

    def told(self, command: jax.Array | None, ground: jax.Array | None = None) -> Self:
        """The environment without chance within its episodes, under this command [n] if it follows any.

        ground: of a body on a terrain, see `TerrainGrid.given`; None: that of each episode.
        """
        del command, ground
        return copy.copy(self)

    def stepped(
        self,
        physics: PhysicsState,
        obs: Observation,
        *,
        rewards: Mapping[str, jax.Array],
        done: jax.Array,
        metrics: Mapping[str, jax.Array],
        info: Mapping[str, jax.Array],
    ) -> State:
        """The state after a step. Its reward is the sum of `rewards`, from first to last, and its metrics
        report the same terms.

        rewards: the weighted terms [] by the names of their metrics; costs are negative. metrics: all others.
        A reset passes its result through `initial`.
        """
        repeated = {name: rewards[term] for name, term in self.aliases.items() if term in rewards}
        reported = {**rewards, **repeated} if self.reports_rewards else {}
        return State(
            physics, obs, reduce(operator.add, rewards.values()), done, {**reported, **metrics}, info
        )


def initial(state: State) -> State:
    """The state as an episode begins: the reward, `done` and every metric of a step are 0."""
    zero = jnp.zeros(())
    return replace(state, reward=zero, done=zero, metrics=dict.fromkeys(state.metrics, zero))


def noisy_start(
    environment: MujocoEnv,
    key: jax.Array,
    model: ModelFields,
    scale: float,
    *,
    normal_velocity: bool,
    velocity_scale: float | None = None,
) -> PhysicsState:
    """The model's initial state with uniform noise in ±scale on the positions, and noise on the velocities.

    normal_velocity: velocities are normal with deviation `velocity_scale`; otherwise uniform in ± that.
    velocity_scale: `scale` if None.
    """
    key_position, key_velocity = jax.random.split(key)
    speed_scale = scale if velocity_scale is None else velocity_scale
    qpos = environment.initial_qpos + jax.random.uniform(
        key_position, (environment.model.nq,), minval=-scale, maxval=scale
    )
    if normal_velocity:
        qvel = speed_scale * jax.random.normal(key_velocity, (environment.model.nv,))
    else:
        qvel = jax.random.uniform(
            key_velocity, (environment.model.nv,), minval=-speed_scale, maxval=speed_scale
        )
    if environment.initial_qvel is not None:
        qvel += environment.initial_qvel
    qpos, qvel = environment.placed(key, qpos, qvel)
    if environment.initial_act is None:
        return environment.engine.reset(qpos, qvel, model)
    return environment.engine.reset(qpos, qvel, model, environment.initial_act)
