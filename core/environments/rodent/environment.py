"""A rat that learns to run. Source: Merel et al., 2020, for the body; rewards as in the tutorial notebook."""

import jax
import jax.numpy as jnp

from core.environments.body import Body, height_is_healthy, noisy_start
from core.environments.environment import State
from core.environments.rodent.info import RodentOptions
from core.environments.rodent.model import rodent_model
from core.physics.engine import NOMINAL, EngineBuilder, ModelFields, PhysicsState, SolverSettings

_DERIVED = ("cinert", "cvel", "qfrc_actuator", "subtree_com")
_METRICS = (
    "forward_reward",
    "reward_linvel",
    "reward_quadctrl",
    "reward_alive",
    "x_position",
    "y_position",
    "height",
    "distance_from_origin",
    "x_velocity",
    "y_velocity",
)


def make(options: RodentOptions, build_engine: EngineBuilder) -> "Rodent":
    """The rodent under these options, moved by the engine that `build_engine` makes."""
    return Rodent(options, build_engine)


class Rodent(Body):
    """Reward: forward speed + being up - the action's cost. It may end when the torso is too low or high."""

    def __init__(self, options: RodentOptions, build_engine: EngineBuilder) -> None:
        model = rodent_model(options.timestep)
        accelerated = SolverSettings(
            iterations=options.iterations,
            ls_iterations=options.ls_iterations,
            # The tail's joints have next to no inertia: without it they fly apart at once.
            implicit_damping=True,
            solver=options.solver,
        )
        hidden = 2 if options.exclude_current_positions_from_observation else 0
        super().__init__(
            model,
            build_engine(model, options.n_frames, _DERIVED, accelerated=accelerated),
            num_substeps=options.n_frames,
            # Each body: 10 numbers of its inertia and 6 of its velocity.
            observation_size=model.nq - hidden + model.nv + 16 * (model.nbody - 1) + model.nv,
            tracked_body="torso",
        )
        # The noise shall not push it into the floor, which would throw it up.
        self.initial_qpos = self.initial_qpos.at[2].add(options.reset_noise_scale)
        self._options = options
        self._num_hidden = hidden

    def reset(self, key: jax.Array, model: ModelFields = NOMINAL) -> State:
        physics = noisy_start(self, key, model, self._options.reset_noise_scale, normal_velocity=False)
        zero = jnp.zeros(())
        return State(physics, self._observe(physics), zero, zero, dict.fromkeys(_METRICS, zero), {})

    def step(self, state: State, action: jax.Array) -> State:
        options = self._options
        physics = self.engine.step(state.physics, action)
        position = self._centre_of_mass(physics)
        velocity = (position - self._centre_of_mass(state.physics)) / self.dt
        height = physics.qpos[2]
        forward = options.forward_reward_weight * velocity[0]
        healthy = height_is_healthy(height, options.healthy_z_range)
        # Where being unhealthy ends the episode, the step that ends it still earns its reward (as in Brax).
        alive = options.healthy_reward * (jnp.ones(()) if options.terminate_when_unhealthy else healthy)
        effort = options.ctrl_cost_weight * jnp.sum(jnp.square(action))
        metrics = {
            "forward_reward": forward,
            "reward_linvel": forward,
            "reward_quadctrl": -effort,
            "reward_alive": alive,
            "x_position": position[0],
            "y_position": position[1],
            "height": height,
            "distance_from_origin": jnp.linalg.norm(position),
            "x_velocity": velocity[0],
            "y_velocity": velocity[1],
        }
        done = 1.0 - healthy if options.terminate_when_unhealthy else jnp.zeros(())
        return State(physics, self._observe(physics), forward + alive - effort, done, metrics, state.info)

    def _centre_of_mass(self, physics: PhysicsState) -> jax.Array:
        """[3], in metres; the torso is the root of all the other bodies."""
        return physics.derived["subtree_com"][self.tracked_body]

    def _observe(self, physics: PhysicsState) -> jax.Array:
        """Positions, velocities, each body's inertia and velocity as MuJoCo has them, actuators' forces."""
        return jnp.concatenate(
            [
                physics.qpos[self._num_hidden :],
                physics.qvel,
                physics.derived["cinert"][1:].ravel(),
                physics.derived["cvel"][1:].ravel(),
                physics.derived["qfrc_actuator"],
            ]
        )
