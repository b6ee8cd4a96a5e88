"""A rat that learns to run. Source: Merel et al., 2020, for the body; rewards as in the tutorial notebook."""

from collections.abc import Mapping
from types import MappingProxyType

import jax
import jax.numpy as jnp

from core.environments import rewards
from core.environments.dm_control.rodent.info import RodentOptions
from core.environments.dm_control.rodent.model import rodent_model, rodent_spec
from core.environments.environment import State
from core.environments.mujoco_env import MujocoEnv, initial, noisy_start, travel
from core.environments.numbers import Ends, Noise, numbers, rows
from core.environments.simulation import Simulation
from core.physics.engine import NOMINAL, EngineBuilder, ModelFields, PhysicsState, SolverSettings

_DERIVED = ("cinert", "cvel", "qfrc_actuator", "subtree_com")


def make(options: RodentOptions, build_engine: EngineBuilder) -> "Rodent":
    """The rodent under these options, moved by the engine that `build_engine` makes."""
    return Rodent(options, build_engine)


class Rodent(MujocoEnv):
    """Reward: forward speed + being up - the action's cost. May end when the torso is too low or too high."""

    # The notebook reports the term under both names, as Brax's humanoid does.
    aliases: Mapping[str, str] = MappingProxyType({"reward_linvel": "forward_reward"})

    def __init__(self, options: RodentOptions, build_engine: EngineBuilder) -> None:
        model = rodent_model(options.timestep)
        # The tail's joints have next to no inertia: without implicit damping they fly apart at once.
        accelerated = SolverSettings.of_job(
            options.iterations, options.ls_iterations, implicit_damping=True, solver=options.solver
        )
        hidden = 2 if options.exclude_current_positions_from_observation else 0
        super().__init__(
            model,
            build_engine(model, options.n_frames, _DERIVED, accelerated=accelerated),
            num_substeps=options.n_frames,
            # For each body: 10 numbers of its inertia and 6 of its velocity.
            observation_size=model.nq - hidden + model.nv + 16 * (model.nbody - 1) + model.nv,
            tracked_body="torso",
        )
        # Noise must not push it into the floor, which would throw it up.
        self.initial_qpos = self.initial_qpos.at[2].add(options.reset_noise_scale)
        self._options = options
        self._num_hidden = hidden

    def reset(self, key: jax.Array, model: ModelFields = NOMINAL) -> State:
        physics = noisy_start(self, key, model, self._options.reset_noise_scale, normal_velocity=False)
        return initial(self._after(physics, physics, jnp.zeros(self.action_size), {}))

    def step(self, state: State, action: jax.Array) -> State:
        physics = self.engine.step(state.physics, action)
        return self._after(state.physics, physics, action, state.info)

    def simulation(self) -> Simulation:
        options, model, scale = self._options, self.model, self._options.reset_noise_scale
        bodies = range(1, model.nbody)
        height = Ends(numbers("qpos", [2]), *options.healthy_z_range)
        return self.simulated(
            rodent_spec(options.timestep),
            observation=[
                numbers("qpos", range(self._num_hidden, model.nq)),
                numbers("qvel", range(model.nv)),
                rows("cinert", bodies, 10),
                rows("cvel", bodies, 6),
                numbers("qfrc_actuator", range(model.nv)),
            ],
            noise=Noise(scale, scale, is_normal=False),
            ends=[height] if options.terminate_when_unhealthy else [],
        )

    def _after(
        self, before: PhysicsState, physics: PhysicsState, action: jax.Array, info: Mapping[str, jax.Array]
    ) -> State:
        options = self._options
        position = self._centre_of_mass(physics)
        velocity = rewards.velocity(self._centre_of_mass(before), position, self.dt)
        height = physics.qpos[2]
        healthy = rewards.height_range(height, options.healthy_z_range)
        survives, done = rewards.survival(healthy, terminates=options.terminate_when_unhealthy)
        return self.stepped(
            physics,
            self._observe(physics),
            rewards={
                "forward_reward": options.forward_reward_weight * velocity[0],
                "reward_alive": options.healthy_reward * survives,
                "reward_quadctrl": -options.ctrl_cost_weight * rewards.control_cost(action),
            },
            done=done,
            metrics={"height": height, **travel(position, velocity)},
            info=info,
        )

    def _centre_of_mass(self, physics: PhysicsState) -> jax.Array:
        """[3], in metres; the torso is the root of all the other bodies."""
        return physics.derived["subtree_com"][self.tracked_body]

    def _observe(self, physics: PhysicsState) -> jax.Array:
        """Positions, velocities, each body's inertia and velocity as in MuJoCo, actuators' forces."""
        return jnp.concatenate(
            [
                physics.qpos[self._num_hidden :],
                physics.qvel,
                physics.derived["cinert"][1:].ravel(),
                physics.derived["cvel"][1:].ravel(),
                physics.derived["qfrc_actuator"],
            ]
        )
