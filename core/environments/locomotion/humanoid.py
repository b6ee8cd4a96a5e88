"""A humanoid that learns to walk. Source: Tassa et al., 2012; rewards as in brax.envs.humanoid."""

from collections.abc import Mapping
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from core.environments import rewards
from core.environments.environment import State
from core.environments.locomotion.info import HumanoidOptions
from core.environments.mujoco_env import (
    MujocoEnv,
    control_range,
    initial,
    noisy_start,
    scaled_to_control,
    travel,
)
from core.environments.numbers import SHARE_VELOCITY, Ends, Noise, numbers, rows
from core.environments.simulation import Simulation
from core.physics.engine import NOMINAL, EngineBuilder, ModelFields, PhysicsState
from core.physics.model import BRAX_SOLVER, brax_model, brax_spec

_NUM_SUBSTEPS = 5
# The six numbers of a symmetric matrix in `cinert` as its nine, row by row.
_SYMMETRIC = (0, 3, 4, 3, 1, 5, 4, 5, 2)
_DERIVED = ("cinert", "cvel", "qfrc_actuator", "subtree_com")


def make(options: HumanoidOptions, build_engine: EngineBuilder) -> "Humanoid":
    """The humanoid under these options, moved by the engine that `build_engine` makes."""
    return Humanoid(options, build_engine)


class Humanoid(MujocoEnv):
    """Reward: forward speed + being alive - the control's cost. Ends when the torso falls."""

    # Brax reports the term under both names.
    aliases: ClassVar[Mapping[str, str]] = {"reward_linvel": "forward_reward"}

    def __init__(self, options: HumanoidOptions, build_engine: EngineBuilder) -> None:
        model = brax_model("humanoid")
        hidden = 2 if options.exclude_current_positions_from_observation else 0
        num_bodies = model.nbody - 1
        super().__init__(
            model,
            build_engine(model, _NUM_SUBSTEPS, _DERIVED, accelerated=BRAX_SOLVER),
            num_substeps=_NUM_SUBSTEPS,
            # For each body: its inertia [3, 3] and mass; its linear and angular velocity.
            observation_size=model.nq - hidden + model.nv + 10 * num_bodies + 6 * num_bodies + model.nv,
            tracked_body="torso",
        )
        self._options = options
        self._num_hidden = hidden
        self._masses = np.asarray(model.body_mass, np.float32)

    def reset(self, key: jax.Array, model: ModelFields = NOMINAL) -> State:
        physics = noisy_start(self, key, model, self._options.reset_noise_scale, normal_velocity=False)
        return initial(self._after(physics, physics, jnp.zeros(self.action_size), {}))

    def step(self, state: State, action: jax.Array) -> State:
        control = scaled_to_control(self.model, action)
        physics = self.engine.step(state.physics, control)
        return self._after(state.physics, physics, control, state.info)

    def simulation(self) -> Simulation:
        options, scale, model = self._options, self._options.reset_noise_scale, self.model
        bodies = range(1, model.nbody)
        height = Ends(numbers("qpos", [2]), *options.healthy_z_range)
        return self.simulated(
            brax_spec("humanoid"),
            observation=[
                numbers("qpos", range(self._num_hidden, model.nq)),
                numbers("qvel", range(model.nv)),
                rows("cinert", bodies, 10, [*_SYMMETRIC, 9]),
                rows(SHARE_VELOCITY, bodies, 6),
                numbers("qfrc_actuator", range(model.nv)),
            ],
            noise=Noise(scale, scale, is_normal=False),
            ends=[height] if options.terminate_when_unhealthy else [],
            control_range=control_range(model),
        )

    def _after(
        self, before: PhysicsState, physics: PhysicsState, control: jax.Array, info: Mapping[str, jax.Array]
    ) -> State:
        options = self._options
        position = self._centre_of_mass(physics)
        velocity = rewards.velocity(self._centre_of_mass(before), position, self.dt)
        healthy = rewards.height_range(physics.qpos[2], options.healthy_z_range)
        survives, done = rewards.survival(healthy, terminates=options.terminate_when_unhealthy)
        return self.stepped(
            physics,
            self._observe(physics),
            rewards={
                "forward_reward": options.forward_reward_weight * velocity[0],
                "reward_alive": options.healthy_reward * survives,
                "reward_quadctrl": -options.ctrl_cost_weight * rewards.control_cost(control),
            },
            done=done,
            metrics=travel(position, velocity),
            info=info,
        )

    def _centre_of_mass(self, physics: PhysicsState) -> jax.Array:
        """[3]; the torso is the root of all the other bodies."""
        return physics.derived["subtree_com"][self.tracked_body]

    def _observe(self, physics: PhysicsState) -> jax.Array:
        """Positions, velocities, each body's inertia and mass, each body's velocities, joint torques.

        Inertia is about the whole body's centre of mass. A linear velocity is that of the body's own
        centre of mass, weighted by its share of the whole mass.
        """
        # cinert: 6 of the inertia, 3 of mass times offset from the whole's centre of mass, 1 mass.
        inertia, moment = physics.derived["cinert"][1:, :6], physics.derived["cinert"][1:, 6:9]
        masses = physics.model.get("body_mass", self._masses)[1:, None]
        symmetric = inertia[:, np.array(_SYMMETRIC)]
        # cvel: angular velocity, then linear velocity at the whole's centre of mass.
        angular, linear = physics.derived["cvel"][1:, :3], physics.derived["cvel"][1:, 3:]
        own_linear = linear + jnp.cross(angular, moment / masses)
        bodies = jnp.concatenate([symmetric, masses], axis=1)
        velocities = jnp.concatenate([own_linear * (masses / masses.sum()), angular], axis=1)
        return jnp.concatenate(
            [
                physics.qpos[self._num_hidden :],
                physics.qvel,
                bodies.ravel(),
                velocities.ravel(),
                physics.derived["qfrc_actuator"],
            ]
        )
