"""A four-legged body that learns to run. Source: Schulman et al., 2015; rewards as in brax.envs.ant."""

from collections.abc import Mapping
from typing import ClassVar

import jax
import jax.numpy as jnp
import mujoco

from core.environments import rewards
from core.environments.environment import State
from core.environments.locomotion.info import AntOptions
from core.environments.mujoco_env import MujocoEnv, initial, noisy_start, travel
from core.environments.numbers import Ends, Noise, numbers
from core.environments.simulation import Simulation
from core.physics.engine import NOMINAL, EngineBuilder, ModelFields, PhysicsState
from core.physics.model import BRAX_SOLVER, brax_spec

_NUM_SUBSTEPS = 5


def make(options: AntOptions, build_engine: EngineBuilder) -> "Ant":
    """The ant under these options, moved by the engine that `build_engine` makes."""
    return Ant(options, build_engine)


def _spec() -> mujoco.MjSpec:
    """Brax's ant with MuJoCo's own limit of 100 solver iterations. Its file allows 4, which was too few in
    1 of 200 steps of a running ant; it stumbled there. Most steps make 1 to 3."""
    spec = brax_spec("ant")
    spec.option.iterations = 100
    return spec


class Ant(MujocoEnv):
    """Reward: forward speed + being alive - the action's cost. Ends when the torso is too low or too high."""

    # Brax reports the term under both names.
    aliases: ClassVar[Mapping[str, str]] = {"forward_reward": "reward_forward"}

    def __init__(self, options: AntOptions, build_engine: EngineBuilder) -> None:
        model = _spec().compile()
        engine = build_engine(model, _NUM_SUBSTEPS, (), accelerated=BRAX_SOLVER)
        hidden = 2 if options.exclude_current_positions_from_observation else 0
        super().__init__(
            model,
            engine,
            num_substeps=_NUM_SUBSTEPS,
            observation_size=model.nq - hidden + model.nv,
            tracked_body="torso",
        )
        self._options = options
        self._num_hidden = hidden

    def reset(self, key: jax.Array, model: ModelFields = NOMINAL) -> State:
        physics = noisy_start(self, key, model, self._options.reset_noise_scale, normal_velocity=True)
        return initial(self._after(physics, physics, jnp.zeros(self.action_size), {}))

    def step(self, state: State, action: jax.Array) -> State:
        physics = self.engine.step(state.physics, action)
        return self._after(state.physics, physics, action, state.info)

    def simulation(self) -> Simulation:
        options, scale = self._options, self._options.reset_noise_scale
        height = Ends(numbers("qpos", [2]), *options.healthy_z_range)
        return self.simulated(
            _spec(),
            observation=[
                numbers("qpos", range(self._num_hidden, self.model.nq)),
                numbers("qvel", range(self.model.nv)),
            ],
            noise=Noise(scale, scale, is_normal=True),
            ends=[height] if options.terminate_when_unhealthy else [],
        )

    def _after(
        self, before: PhysicsState, physics: PhysicsState, action: jax.Array, info: Mapping[str, jax.Array]
    ) -> State:
        options = self._options
        torso = physics.qpos[:3]
        velocity = rewards.velocity(before.qpos[:3], torso, self.dt)
        healthy = rewards.height_range(torso[2], options.healthy_z_range)
        survives, done = rewards.survival(healthy, terminates=options.terminate_when_unhealthy)
        return self.stepped(
            physics,
            self._observe(physics),
            rewards={
                "reward_forward": velocity[0],
                "reward_survive": options.healthy_reward * survives,
                "reward_ctrl": -options.ctrl_cost_weight * rewards.control_cost(action),
                "reward_contact": jnp.zeros(()),  # Brax has the term, and no contact forces for it.
            },
            done=done,
            metrics=travel(torso, velocity),
            info=info,
        )

    def _observe(self, physics: PhysicsState) -> jax.Array:
        return jnp.concatenate([physics.qpos[self._num_hidden :], physics.qvel])
