"""A planar two-legged body that learns to run. Rewards as in brax.envs.half_cheetah."""

from collections.abc import Mapping

import jax
import jax.numpy as jnp

from core.environments import rewards
from core.environments.environment import State
from core.environments.locomotion.info import HalfCheetahOptions
from core.environments.mujoco_env import MujocoEnv, initial, noisy_start
from core.environments.numbers import Noise, numbers
from core.environments.simulation import Simulation
from core.physics.engine import NOMINAL, EngineBuilder, ModelFields, PhysicsState
from core.physics.model import brax_model, brax_spec

_NUM_SUBSTEPS = 5


def make(options: HalfCheetahOptions, build_engine: EngineBuilder) -> "HalfCheetah":
    """The half cheetah under these options, moved by the engine that `build_engine` makes."""
    return HalfCheetah(options, build_engine)


class HalfCheetah(MujocoEnv):
    """Reward: forward speed - the action's cost. It never terminates."""

    def __init__(self, options: HalfCheetahOptions, build_engine: EngineBuilder) -> None:
        model = brax_model("half_cheetah")
        hidden = 1 if options.exclude_current_positions_from_observation else 0
        super().__init__(
            model,
            build_engine(model, _NUM_SUBSTEPS, ()),
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
        scale = self._options.reset_noise_scale
        return self.simulated(
            brax_spec("half_cheetah"),
            observation=[
                numbers("qpos", range(self._num_hidden, self.model.nq)),
                numbers("qvel", range(self.model.nv)),
            ],
            noise=Noise(scale, scale, is_normal=True),
            ends=[],
        )

    def _after(
        self, before: PhysicsState, physics: PhysicsState, action: jax.Array, info: Mapping[str, jax.Array]
    ) -> State:
        velocity = rewards.velocity(before.qpos[0], physics.qpos[0], self.dt)
        return self.stepped(
            physics,
            self._observe(physics),
            rewards={
                "reward_run": self._options.forward_reward_weight * velocity,
                "reward_ctrl": -self._options.ctrl_cost_weight * rewards.control_cost(action),
            },
            done=jnp.zeros(()),
            metrics={"x_position": physics.qpos[0], "x_velocity": velocity},
            info=info,
        )

    def _observe(self, physics: PhysicsState) -> jax.Array:
        return jnp.concatenate([physics.qpos[self._num_hidden :], physics.qvel])
