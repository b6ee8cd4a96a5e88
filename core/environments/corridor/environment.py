"""A walker that learns to run down a corridor. Rewards as in the tutorial notebook."""

import jax
import jax.numpy as jnp

from core.environments.body import Body, height_is_healthy, noisy_start
from core.environments.corridor.info import CorridorOptions
from core.environments.corridor.model import corridor_model, obstacle_ends
from core.environments.corridor.walkers import WALKERS
from core.environments.environment import State
from core.physics.engine import NOMINAL, EngineBuilder, ModelFields, PhysicsState, SolverSettings

_DERIVED = ("subtree_com", "xpos")
# The top of the ground; a trunk below it is in a gap.
_GROUND_M = 0.0
_METRICS = (
    "forward_reward",
    "reward_linvel",
    "distance_reward",
    "reward_alive",
    "reward_quadctrl",
    "x_position",
    "y_position",
    "height",
    "distance_from_origin",
    "x_velocity",
    "y_velocity",
    "obstacles_passed",
    "fell",
)


def make(options: CorridorOptions, build_engine: EngineBuilder) -> "Corridor":
    """The corridor under these options, moved by the engine that `build_engine` makes."""
    return Corridor(options, build_engine)


class Corridor(Body):
    """Reward: forward speed + distance + being up - the action's cost. Ends in a gap or out of the range."""

    def __init__(self, options: CorridorOptions, build_engine: EngineBuilder) -> None:
        model = corridor_model(options)
        accelerated = SolverSettings(
            iterations=options.iterations,
            ls_iterations=options.ls_iterations,
            implicit_damping=True,
            solver=options.solver,
        )
        hidden = 2 if options.exclude_current_positions_from_observation else 0
        super().__init__(
            model,
            build_engine(model, options.n_frames, _DERIVED, accelerated=accelerated),
            num_substeps=options.n_frames,
            observation_size=model.nq - hidden + model.nv,
            tracked_body=WALKERS[options.walker].trunk,
        )
        self.episode_length = options.episode_length
        # The noise shall not push it into the ground, which would throw it up.
        self.initial_qpos = self.initial_qpos.at[2].add(options.reset_noise_scale)
        self._options = options
        self._num_hidden = hidden
        self._obstacle_ends = jnp.asarray(obstacle_ends(model), jnp.float32)

    def reset(self, key: jax.Array, model: ModelFields = NOMINAL) -> State:
        physics = noisy_start(self, key, model, self._options.reset_noise_scale, normal_velocity=False)
        zero = jnp.zeros(())
        return State(physics, self._observe(physics), zero, zero, dict.fromkeys(_METRICS, zero), {})

    def step(self, state: State, action: jax.Array) -> State:
        options = self._options
        physics = self.engine.step(state.physics, action)
        before, after = self._centre_of_mass(state.physics), self._centre_of_mass(physics)
        velocity = (after - before) / self.dt
        height = physics.derived["xpos"][self.tracked_body, 2]
        forward = options.forward_reward_weight * velocity[0]
        distance = options.distance_reward_weight * velocity[0] * self.dt
        healthy = height_is_healthy(height, options.healthy_range)
        # Where being unhealthy ends the episode, the step that ends it still earns its reward (as in Brax).
        alive = options.healthy_reward * (jnp.ones(()) if options.terminate_when_unhealthy else healthy)
        effort = options.ctrl_cost_weight * jnp.sum(jnp.square(action))
        fell = jnp.where(height < _GROUND_M, 1.0, 0.0)
        done = jnp.maximum(fell, 1.0 - healthy) if options.terminate_when_unhealthy else fell
        metrics = {
            "forward_reward": forward,
            "reward_linvel": forward,
            "distance_reward": distance,
            "reward_alive": alive,
            "reward_quadctrl": -effort,
            "x_position": after[0],
            "y_position": after[1],
            "height": height,
            "distance_from_origin": jnp.linalg.norm(after),
            "x_velocity": velocity[0],
            "y_velocity": velocity[1],
            "obstacles_passed": self._num_behind(after[0]) - self._num_behind(before[0]),
            "fell": jnp.maximum(fell, 1.0 - healthy),
        }
        reward = forward + distance + alive - effort
        return State(physics, self._observe(physics), reward, done, metrics, state.info)

    def _centre_of_mass(self, physics: PhysicsState) -> jax.Array:
        """[3], in metres, of the trunk and all that hangs on it: the walker, and nothing of the arena."""
        return physics.derived["subtree_com"][self.tracked_body]

    def _num_behind(self, x: jax.Array) -> jax.Array:
        """How many gaps or walls [] end behind x."""
        return jnp.sum(x > self._obstacle_ends, dtype=jnp.float32)

    def _observe(self, physics: PhysicsState) -> jax.Array:
        return jnp.concatenate([physics.qpos[self._num_hidden :], physics.qvel])
