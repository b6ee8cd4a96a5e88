"""A pole balanced on a cart. Source: Barto et al., 1983; rewards as in brax.envs.inverted_pendulum."""

from collections.abc import Mapping

import jax
import jax.numpy as jnp

from core.environments.environment import State
from core.environments.info import NoOptions
from core.environments.mujoco_env import MujocoEnv, control_range, initial, noisy_start, scaled_to_control
from core.environments.numbers import Ends, Noise, numbers
from core.environments.simulation import Simulation
from core.physics.engine import NOMINAL, EngineBuilder, ModelFields, PhysicsState
from core.physics.model import brax_model, brax_spec

_NUM_SUBSTEPS = 2
_NOISE = 0.01
_LARGEST_TILT = 0.2  # radians


def make(options: NoOptions, build_engine: EngineBuilder) -> "InvertedPendulum":
    """The inverted pendulum, moved by the engine that `build_engine` makes."""
    return InvertedPendulum(build_engine)


class InvertedPendulum(MujocoEnv):
    """Reward: 1 for each step. Ends when the pole tilts too far."""

    # As in Brax: there is one term, which is the reward itself.
    reports_rewards = False

    def __init__(self, build_engine: EngineBuilder) -> None:
        model = brax_model("inverted_pendulum")
        super().__init__(
            model,
            build_engine(model, _NUM_SUBSTEPS, ()),
            num_substeps=_NUM_SUBSTEPS,
            observation_size=model.nq + model.nv,
            tracked_body="cart",
        )

    def reset(self, key: jax.Array, model: ModelFields = NOMINAL) -> State:
        physics = noisy_start(self, key, model, _NOISE, normal_velocity=False)
        return initial(self._after(physics, {}))

    def step(self, state: State, action: jax.Array) -> State:
        physics = self.engine.step(state.physics, scaled_to_control(self.model, action))
        return self._after(physics, state.info)

    def simulation(self) -> Simulation:
        tilt = numbers("qpos", [1])
        return self.simulated(
            brax_spec("inverted_pendulum"),
            observation=[numbers("qpos", range(self.model.nq)), numbers("qvel", range(self.model.nv))],
            noise=Noise(_NOISE, _NOISE, is_normal=False),
            ends=[Ends(tilt, -_LARGEST_TILT, _LARGEST_TILT)],
            control_range=control_range(self.model),
        )

    def _after(self, physics: PhysicsState, info: Mapping[str, jax.Array]) -> State:
        # Not rewards.upright, a cosine: Brax bounds the hinge's angle.
        done = jnp.where(jnp.abs(physics.qpos[1]) > _LARGEST_TILT, 1.0, 0.0)
        alive = {"reward_alive": jnp.ones(())}
        return self.stepped(physics, _observe(physics), rewards=alive, done=done, metrics={}, info=info)


def _observe(physics: PhysicsState) -> jax.Array:
    return jnp.concatenate([physics.qpos, physics.qvel])
