"""The torque that is left to electric motors at the speed of their joints."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from core.environments.terms.actuation import joint_names, motor_of


@dataclass(frozen=True)
class TorqueSpeedCurve:
    """The torque of motors falls in a line from that at rest to 0 at the velocity limit, within the greatest
    torque that the actuator may give; against the motion they brake with all of that.

    actuators, dofs: numbers of the actuators and of what they move. velocity_limit, saturation_effort: of
    their motors. All [motors]. own: the model's own ranges, [nu, 2].
    Source: the actuator model DCMotor of Isaac Lab.
    """

    actuators: np.ndarray
    dofs: np.ndarray
    velocity_limit: np.ndarray
    saturation_effort: np.ndarray
    own: np.ndarray

    @classmethod
    def of(cls, model: mujoco.MjModel) -> "TorqueSpeedCurve":
        """The curve of the model's motors, where these are known."""
        known = [
            (n, motor) for n, joint in enumerate(joint_names(model)) if (motor := motor_of(model, joint))
        ]
        actuators = np.array([number for number, _ in known], int)
        limits, efforts = np.array([motor for _, motor in known], np.float32).reshape(-1, 2).T
        dofs = model.jnt_dofadr[model.actuator_trnid[actuators, 0]]
        return cls(actuators, dofs, limits, efforts, model.actuator_forcerange.astype(np.float32))

    def force_range(self, qvel: jax.Array, own: jax.Array | None) -> jax.Array:
        """The ranges [nu, 2] at these velocities [nv]. own: those of the episode, if it has its own."""
        ranges = jnp.asarray(self.own) if own is None else own
        share = qvel[self.dofs] / self.velocity_limit
        low, high = ranges[self.actuators].T
        return ranges.at[self.actuators].set(
            jnp.stack(
                [
                    -jnp.clip(self.saturation_effort * (1.0 + share), 0.0, -low),
                    jnp.clip(self.saturation_effort * (1.0 - share), 0.0, high),
                ],
                axis=-1,
            )
        )
