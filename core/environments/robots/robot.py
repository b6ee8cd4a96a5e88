"""A robot as the catalog knows it before its file is read; no numerical code."""

from collections.abc import Mapping
from dataclasses import dataclass

from core.environments.mjcf.edit_options import ModelEdits, Servo, gains

# Of the target's way that the greatest torque holds against the spring: actions of ±1 then ask for a quarter.
_SHARE_OF_EFFORT = 0.25


@dataclass(frozen=True)
class Robot:
    """A file of a package, and how it becomes a body that can be trained.

    package: its import name; it is never imported. file: its place in the package. edits: what is changed
    before it is compiled. timestep: s. root: the body with the free joint. feet: in the order of terms.
    """

    name: str
    package: str
    file: str
    edits: ModelEdits
    timestep: float
    root: str
    feet: tuple[str, ...]

    @property
    def action_scale(self) -> Mapping[str, float]:
        """By pattern of joints: how far an action of 1 moves the target from the pose, rad."""
        return {pattern: scale_of(servo) for servo in self.edits.servos for pattern in servo.joints}


def scale_of(servo: Servo) -> float:
    """How far an action of 1 moves the servo's target, rad: there, a quarter of its effort pushes.

    Raises ValueError if the servo says no effort.
    """
    if servo.effort is None:
        raise ValueError("a servo without a greatest torque has no scale of its own")
    kp, _ = gains(servo, servo.effort)
    return _SHARE_OF_EFFORT * servo.effort / kp
