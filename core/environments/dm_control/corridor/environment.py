"""A walker that learns to run down a corridor. Rewards as in the tutorial notebook."""

import jax
import jax.numpy as jnp

from core.environments import rewards
from core.environments.dm_control.corridor.info import CorridorOptions
from core.environments.dm_control.corridor.model import corridor_model, obstacles
from core.environments.dm_control.corridor.walkers import WALKERS
from core.environments.environment import State
from core.environments.mujoco_env import TRAVEL, MujocoEnv, noisy_start, travel
from core.physics.engine import NOMINAL, EngineBuilder, ModelFields, PhysicsState, SolverSettings

_DERIVED = ("subtree_com", "xpos")
# The top of the ground; a trunk below it is in a gap.
_GROUND_M = 0.0
_SIGHT_M = 10.0
_METRICS = (
    "forward_reward",
    "reward_linvel",
    "distance_reward",
    "reward_alive",
    "reward_quadctrl",
    "height",
    "obstacles_passed",
    "fell",
    *TRAVEL,
)


def make(options: CorridorOptions, build_engine: EngineBuilder) -> "Corridor":
    """The corridor under these options, moved by the engine that `build_engine` makes."""
    return Corridor(options, build_engine)


class Corridor(MujocoEnv):
    """Reward: forward speed + distance + being up - the action's cost.

    An episode ends when the trunk falls into a gap or leaves the healthy range.
    """

    def __init__(self, options: CorridorOptions, build_engine: EngineBuilder) -> None:
        model = corridor_model(options)
        accelerated = SolverSettings(
            options.iterations, options.ls_iterations, implicit_damping=True, solver=options.solver
        )
        hidden = 2 if options.exclude_current_positions_from_observation else 0
        super().__init__(
            model,
            build_engine(model, options.n_frames, _DERIVED, accelerated=accelerated),
            num_substeps=options.n_frames,
            observation_size=model.nq - hidden + model.nv + 3 * options.num_next_obstacles,
            tracked_body=WALKERS[options.walker].trunk,
        )
        self.episode_length = options.episode_length
        # Noise must not push it into the ground, which would throw it up.
        self.initial_qpos = self.initial_qpos.at[2].add(options.reset_noise_scale)
        self._options = options
        self._num_hidden = hidden
        self._obstacles = jnp.reshape(jnp.asarray(obstacles(model), jnp.float32), (-1, 3))

    def reset(self, key: jax.Array, model: ModelFields = NOMINAL) -> State:
        physics = noisy_start(self, key, model, self._options.reset_noise_scale, normal_velocity=False)
        zero = jnp.zeros(())
        return State(physics, self._observe(physics), zero, zero, dict.fromkeys(_METRICS, zero), {})

    def step(self, state: State, action: jax.Array) -> State:
        options = self._options
        physics = self.engine.step(state.physics, action)
        before, after = self._centre_of_mass(state.physics), self._centre_of_mass(physics)
        velocity = rewards.velocity(before, after, self.dt)
        height = physics.derived["xpos"][self.tracked_body, 2]
        forward = options.forward_reward_weight * velocity[0]
        distance = options.distance_reward_weight * velocity[0] * self.dt
        healthy = rewards.height_range(height, options.healthy_range)
        survives, ended = rewards.survival(healthy, terminates=options.terminate_when_unhealthy)
        alive = options.healthy_reward * survives
        effort = options.ctrl_cost_weight * rewards.control_cost(action)
        fell = jnp.where(height < _GROUND_M, 1.0, 0.0)
        metrics = {
            "forward_reward": forward,
            "reward_linvel": forward,
            "distance_reward": distance,
            "reward_alive": alive,
            "reward_quadctrl": -effort,
            "height": height,
            **travel(after, velocity),
            "obstacles_passed": self._num_behind(after[0]) - self._num_behind(before[0]),
            "fell": jnp.maximum(fell, 1.0 - healthy),
        }
        reward = forward + distance + alive - effort
        done = jnp.maximum(fell, ended)
        return State(physics, self._observe(physics), reward, done, metrics, state.info)

    def _centre_of_mass(self, physics: PhysicsState) -> jax.Array:
        """[3], in metres, of the trunk's subtree: the walker, without the arena."""
        return physics.derived["subtree_com"][self.tracked_body]

    def _num_behind(self, x: jax.Array) -> jax.Array:
        """How many gaps or walls [] end behind x."""
        return jnp.sum(x > self._obstacles[:, 1], dtype=jnp.float32)

    def _observe(self, physics: PhysicsState) -> jax.Array:
        seen = self._ahead(physics.qpos[:2], self._options.num_next_obstacles)
        return jnp.concatenate([physics.qpos[self._num_hidden :], physics.qvel, seen])

    def _ahead(self, at: jax.Array, number: int) -> jax.Array:
        """[3 number]: for each next gap or wall, how far ahead of `at` [x, y] it begins and ends, and how far
        to the left the middle of the way past it is. Distances are capped at _SIGHT_M."""
        nothing = jnp.tile(jnp.array([jnp.inf, jnp.inf, 0.0]), (number, 1))
        first = self._num_behind(at[0]).astype(jnp.int32)
        rows = jax.lax.dynamic_slice(jnp.concatenate([self._obstacles, nothing]), (first, 0), (number, 3))
        ahead = jnp.minimum(rows[:, :2] - at[0], _SIGHT_M)
        left = jnp.where(ahead[:, :1] < _SIGHT_M, rows[:, 2:] - at[1], 0.0)
        return jnp.concatenate([ahead, left], axis=1).ravel()
