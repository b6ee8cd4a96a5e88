"""Electric motors behind gears, and the servos made of them; no numerical code."""

from dataclasses import dataclass
from math import pi

from core.environments.mjcf.edit_options import Servo


@dataclass(frozen=True)
class Motor:
    """A motor as its joint feels it: armature in kg m², effort in N m, velocity_limit in rad/s."""

    armature: float
    effort: float
    velocity_limit: float

    def servo(
        self, joints: list[str], *, number: int = 1, frequency: float = 10.0, damping_ratio: float = 2.0
    ) -> Servo:
        """A servo that moves the motor's own inertia as a damped spring does. frequency: undamped, in Hz.

        number: motors that share each joint, at a ratio of 1, as where two rods drive an ankle.
        """
        armature, rate = number * self.armature, 2 * pi * frequency
        return Servo(
            joints=joints,
            kp=armature * rate**2,
            kd=2 * damping_ratio * armature * rate,
            effort=number * self.effort,
            velocity_limit=self.velocity_limit,
            armature=armature,
        )


def geared(rotor: float, gear: float) -> float:
    """The armature of a motor behind one stage of gears, kg m². rotor: its inertia in kg m²."""
    return rotor * gear**2


def planetary(inertias: tuple[float, float, float], gears: tuple[float, float]) -> float:
    """The armature of a motor behind two stages of planetary gears, kg m².

    inertias: of the rotor, and of what turns behind each stage, in kg m². gears: each stage's ratio.
    """
    rotor, behind_first, behind_second = inertias
    first, second = gears
    return rotor * (first * second) ** 2 + behind_first * second**2 + behind_second
