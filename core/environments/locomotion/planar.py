"""The hopper and the planar walker: a torso on x, z and pitch that must not fall."""

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

import jax
import jax.numpy as jnp

from core.environments import rewards
from core.environments.environment import State
from core.environments.locomotion.info import MAX_OBSERVED_SPEED, HopperOptions, Walker2dOptions
from core.environments.mujoco_env import MujocoEnv, initial, noisy_start
from core.environments.numbers import Ends, Noise, numbers
from core.environments.simulation import Simulation
from core.physics.engine import NOMINAL, EngineBuilder, ModelFields, PhysicsState
from core.physics.model import brax_model, brax_spec

_NUM_SUBSTEPS = 4


class PlanarOptions(Protocol):
    """The options that a planar walker reads: fields of its body's own options."""

    forward_reward_weight: float
    ctrl_cost_weight: float
    healthy_reward: float
    terminate_when_unhealthy: bool
    healthy_angle_range: tuple[float, float]
    reset_noise_scale: float
    exclude_current_positions_from_observation: bool

    @property
    def healthy_z_range(self) -> tuple[float, float | None]: ...


def _always(_: PhysicsState) -> jax.Array:
    return jnp.ones((), bool)


class PlanarWalker(MujocoEnv):
    """Reward: forward speed + being alive - the action's cost. Ends when the torso falls, flies or tilts.

    name: of the model. also_healthy: a further condition on the state; also_ends: the same for a simulation.
    """

    def __init__(
        self,
        name: str,
        options: PlanarOptions,
        build_engine: EngineBuilder,
        also_healthy: Callable[[PhysicsState], jax.Array] = _always,
        also_ends: Sequence[Ends] = (),
    ) -> None:
        model = brax_model(name)
        hidden = 1 if options.exclude_current_positions_from_observation else 0
        super().__init__(
            model,
            build_engine(model, _NUM_SUBSTEPS, ()),
            num_substeps=_NUM_SUBSTEPS,
            observation_size=model.nq - hidden + model.nv,
            tracked_body="torso",
        )
        self._name = name
        self._options = options
        self._also_healthy = also_healthy
        self._also_ends = also_ends
        self._num_hidden = hidden
        # The joint `rootz` counts from here.
        self._height_at_zero = float(model.body("torso").pos[2])

    def reset(self, key: jax.Array, model: ModelFields = NOMINAL) -> State:
        physics = noisy_start(self, key, model, self._options.reset_noise_scale, normal_velocity=False)
        return initial(self._after(physics, physics, jnp.zeros(self.action_size), {}))

    def step(self, state: State, action: jax.Array) -> State:
        physics = self.engine.step(state.physics, action)
        return self._after(state.physics, physics, action, state.info)

    def simulation(self) -> Simulation:
        options, scale = self._options, self._options.reset_noise_scale
        height = numbers("qpos", [1], add=self._height_at_zero)
        ends = [
            Ends(height, *options.healthy_z_range),
            Ends(numbers("qpos", [2]), *options.healthy_angle_range),
            *self._also_ends,
        ]
        return self.simulated(
            brax_spec(self._name),
            observation=[
                numbers("qpos", range(self._num_hidden, 1)),
                height,
                numbers("qpos", range(2, self.model.nq)),
                numbers("qvel", range(self.model.nv), max_abs=MAX_OBSERVED_SPEED),
            ],
            noise=Noise(scale, scale, is_normal=False),
            ends=ends if options.terminate_when_unhealthy else [],
        )

    def _after(
        self, before: PhysicsState, physics: PhysicsState, action: jax.Array, info: Mapping[str, jax.Array]
    ) -> State:
        options = self._options
        velocity = rewards.velocity(before.qpos[0], physics.qpos[0], self.dt)
        healthy = self._is_healthy(physics).astype(jnp.float32)
        survives, done = rewards.survival(healthy, terminates=options.terminate_when_unhealthy)
        return self.stepped(
            physics,
            self._observe(physics),
            rewards={
                "reward_forward": options.forward_reward_weight * velocity,
                "reward_healthy": options.healthy_reward * survives,
                "reward_ctrl": -options.ctrl_cost_weight * rewards.control_cost(action),
            },
            done=done,
            metrics={"x_position": physics.qpos[0], "x_velocity": velocity},
            info=info,
        )

    def _height(self, physics: PhysicsState) -> jax.Array:
        return physics.qpos[1] + self._height_at_zero

    def _is_healthy(self, physics: PhysicsState) -> jax.Array:
        upright = is_inside(physics.qpos[2], self._options.healthy_angle_range)
        up = is_inside(self._height(physics), self._options.healthy_z_range)
        return up & upright & self._also_healthy(physics)

    def _observe(self, physics: PhysicsState) -> jax.Array:
        positions = physics.qpos.at[1].set(self._height(physics))
        velocities = jnp.clip(physics.qvel, -MAX_OBSERVED_SPEED, MAX_OBSERVED_SPEED)
        return jnp.concatenate([positions[self._num_hidden :], velocities])


def is_inside(value: jax.Array, bounds: tuple[float, float | None]) -> jax.Array:
    """Whether each value lies strictly between the bounds; no upper bound where it is None."""
    # Not rewards.height_range: in Brax these bodies' bounds are themselves unhealthy, and so is NaN.
    low, high = bounds
    above = value > low
    return above if high is None else above & (value < high)


def hopper(options: HopperOptions, build_engine: EngineBuilder) -> PlanarWalker:
    """The hopper under these options, moved by the engine that `build_engine` makes."""

    def other_joints_are_healthy(physics: PhysicsState) -> jax.Array:
        joints = jnp.concatenate([physics.qpos[2:], physics.qvel])
        return jnp.all(is_inside(joints, options.healthy_state_range))

    other_ends = [
        Ends(numbers("qpos", range(2, 6)), *options.healthy_state_range),
        Ends(numbers("qvel", range(6)), *options.healthy_state_range),
    ]
    return PlanarWalker("hopper", options, build_engine, other_joints_are_healthy, other_ends)


def walker2d(options: Walker2dOptions, build_engine: EngineBuilder) -> PlanarWalker:
    """The planar walker under these options, moved by the engine that `build_engine` makes."""
    return PlanarWalker("walker2d", options, build_engine)
