"""How constraints give way: MuJoCo's `solref` and `solimp`.

Source: MuJoCo's documentation, Modeling, "Solver parameters".
"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from mujoco_compiled.program.arithmetic import Number, absolute, maximum, minimum, select, sqrt, squared

_SMALLEST = float(mujoco.mjMINVAL)
_DEFAULT = (0.02, 1.0)


@dataclass(frozen=True)
class Impedance:
    """d(r): `lowest` at the surface, `highest` at a depth of `width` in m or rad, a curve between."""

    lowest: float
    highest: float
    width: float
    midpoint: float
    power: float


@dataclass(frozen=True)
class SpringDamper:
    """A row at distance r < 0 with speed v wants the acceleration -damping · v - stiffness · d(r) · r."""

    stiffness: Number
    damping: Number
    impedance: Impedance


def read_spring(solref: Sequence[Number], solimp: np.ndarray, timestep: float) -> SpringDamper:
    """solref: [2], a time constant and a damping ratio, or a stiffness and a damping below 0. solimp: [5]."""
    lowest, highest = (_between_bounds(x) for x in solimp[:2])
    width, midpoint, power = (
        max(0.0, float(solimp[2])),
        _between_bounds(solimp[3]),
        max(1.0, float(solimp[4])),
    )
    first, second = solref
    are_times, is_damped = first > 0.0, second > 0.0
    # MuJoCo takes the default where one of the two numbers is positive and the other is not.
    default = _of_times(*_DEFAULT, highest, timestep)
    of_times = _of_times(first, second, highest, timestep)
    direct = -first * (1.0 / max(_SMALLEST, highest**2)), -second * (1.0 / max(_SMALLEST, highest))
    stiffness, damping = (
        select(are_times, select(is_damped, x, y), select(is_damped, y, z))
        for x, y, z in zip(of_times, default, direct, strict=True)
    )
    return SpringDamper(stiffness, damping, Impedance(lowest, highest, width, midpoint, power))


def _of_times(time: Number, ratio: Number, highest: float, timestep: float) -> tuple[Number, Number]:
    """The stiffness and damping of a time constant in s and a damping ratio."""
    time_constant = maximum(time, 2.0 * timestep)
    lowest = maximum(highest**2 * (squared(time_constant) * squared(ratio)), _SMALLEST)
    return 1.0 / lowest, 2.0 / maximum(highest * time_constant, _SMALLEST)


def is_computable(power: float) -> bool:
    """Whether the power of a curve is a multiple of a half: stages have roots, not logarithms."""
    return 2.0 * max(1.0, power) in range(2, 33)


def impedance_at(impedance: Impedance, distance: Number) -> Number:
    """d(distance)."""
    if impedance.lowest == impedance.highest or impedance.width <= _SMALLEST:
        return 0.5 * (impedance.lowest + impedance.highest)
    x = minimum(absolute(distance) * (1.0 / impedance.width), 1.0)
    return impedance.lowest + _curve(impedance, x) * (impedance.highest - impedance.lowest)


def stiffness_at(impedance: Number, inverse_weight: Number, distance: Number) -> Number:
    """The stiffness; 0 where the constraint is not active."""
    return select(distance < 0.0, full_stiffness(impedance, inverse_weight), 0.0)


def full_stiffness(impedance: Number, inverse_weight: Number) -> Number:
    """1 / R, with R = (1 - d) / d · A. A is 0 where nothing moves, as along a tendon of coefficients 0."""
    weight = max(inverse_weight, _SMALLEST) if isinstance(inverse_weight, float) else inverse_weight
    return impedance / ((1.0 - impedance) * weight)


def reference_at(spring: SpringDamper, impedance: Number, distance: Number, speed: Number) -> Number:
    """The wanted acceleration."""
    return -(spring.damping * speed + spring.stiffness * (impedance * distance))


def _curve(impedance: Impedance, x: Number) -> Number:
    """From 0 to 1 as x does."""
    middle, power = impedance.midpoint, impedance.power
    if power == 1.0:
        return x
    below = (1.0 / middle ** (power - 1.0)) * _to_the(x, power)
    above = 1.0 - (1.0 / (1.0 - middle) ** (power - 1.0)) * _to_the(1.0 - x, power)
    return select(x < middle, below, above)


def _to_the(x: Number, power: float) -> Number:
    """x to the power of a multiple of a half."""
    whole, has_root = divmod(round(2.0 * power), 2)
    factors: Sequence[Number] = [x] * whole + [sqrt(x)] * has_root
    product = factors[0]
    for factor in factors[1:]:
        product = product * factor
    return product


def _between_bounds(x: float) -> float:
    return float(np.clip(x, mujoco.mjMINIMP, mujoco.mjMAXIMP))
