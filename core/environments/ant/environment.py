"""A four-legged body that learns to run. Source: Schulman et al., 2015; rewards as in brax.envs.ant."""

import jax
import jax.numpy as jnp

from core.environments.ant.info import AntOptions
from core.environments.body import Body, height_is_healthy, noisy_start
from core.environments.environment import State
from core.physics.engine import NOMINAL, EngineBuilder, ModelFields, PhysicsState, SolverSettings
from core.physics.model import brax_model

_NUM_SUBSTEPS = 5
_METRICS = (
    "reward_forward",
    "reward_survive",
    "reward_ctrl",
    "reward_contact",
    "x_position",
    "y_position",
    "distance_from_origin",
    "x_velocity",
    "y_velocity",
    "forward_reward",
)


def make(options: AntOptions, build_engine: EngineBuilder) -> "Ant":
    """The ant under these options, moved by the engine that `build_engine` makes."""
    return Ant(options, build_engine)


class Ant(Body):
    """Reward: forward speed + being alive - the action's cost. Ends when the torso is too low or too high."""

    def __init__(self, options: AntOptions, build_engine: EngineBuilder) -> None:
        model = brax_model("ant")
        accelerated = SolverSettings(iterations=1, ls_iterations=4, implicit_damping=False)
        engine = build_engine(model, _NUM_SUBSTEPS, (), accelerated=accelerated)
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
        zero = jnp.zeros(())
        return State(physics, self._observe(physics), zero, zero, dict.fromkeys(_METRICS, zero), {})

    def step(self, state: State, action: jax.Array) -> State:
        before = state.physics.qpos[:3]
        physics = self.engine.step(state.physics, action)
        torso = physics.qpos[:3]
        velocity = (torso - before) / self.dt
        healthy = height_is_healthy(torso[2], self._options.healthy_z_range)
        terminates = self._options.terminate_when_unhealthy
        # Where being unhealthy ends the episode, the step that ends it still earns its reward (as in Brax).
        survive = self._options.healthy_reward * (jnp.ones(()) if terminates else healthy)
        control = self._options.ctrl_cost_weight * jnp.sum(jnp.square(action))
        metrics = {
            "reward_forward": velocity[0],
            "reward_survive": survive,
            "reward_ctrl": -control,
            "reward_contact": jnp.zeros(()),
            "x_position": torso[0],
            "y_position": torso[1],
            "distance_from_origin": jnp.linalg.norm(torso),
            "x_velocity": velocity[0],
            "y_velocity": velocity[1],
            "forward_reward": velocity[0],
        }
        reward = velocity[0] + survive - control
        done = 1.0 - healthy if terminates else jnp.zeros(())
        return State(physics, self._observe(physics), reward, done, metrics, state.info)

    def _observe(self, physics: PhysicsState) -> jax.Array:
        return jnp.concatenate([physics.qpos[self._num_hidden :], physics.qvel])
