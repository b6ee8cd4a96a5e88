"""The law of a contact whose forces stay in an elliptic cone.

Source: MuJoCo's documentation, Computation, "Constraint model", "Friction cones".
"""

from collections.abc import Sequence
from dataclasses import dataclass

from mujoco_compiled.constraints.laws import Slope
from mujoco_compiled.program.arithmetic import (
    Matrix,
    Number,
    Vector,
    dot,
    maximum,
    select,
    sqrt,
    squared,
    total,
)

# The least squared length whose inverse to the third power is finite in single precision.
_SMALLEST = 1e-20


@dataclass(frozen=True)
class Cone:
    """A `laws.Law`. Its first direction is the normal.

    stiffness: along the normal. slope_of_cone: `mu` of MuJoCo's contact, which `impratio` makes less than the
    first friction. friction: by direction but the normal.
    """

    stiffness: Number
    slope_of_cone: Number
    friction: Sequence[Number]

    def forces(self, residual: Vector) -> Vector:
        pressed = self._place(residual).pressed
        return [-self._unit_stiffness * (scale * x) for scale, x in zip(self._scales, pressed, strict=True)]

    def weights(self, residual: Vector) -> Matrix:
        place, size = self._place(residual), len(residual)
        units: Matrix = [[place.bend_normal, *(place.bend_mixed * x for x in place.across)]]
        for j, x in enumerate(place.across):
            row = [
                place.bend_around * (x * y) + (place.share if j == k else 0.0)
                for k, y in enumerate(place.across)
            ]
            units.append([units[0][j + 1], *row])
        scales = [self._unit_stiffness * scale for scale in self._scales]
        return [[units[j][k] * (scales[j] * self._scales[k]) for k in range(size)] for j in range(size)]

    def slope(self, residual: Vector, rates: Vector) -> Slope:
        normal_rate, *across_rates = [scale * x for scale, x in zip(self._scales, rates, strict=True)]
        across_squared = dot(across_rates, across_rates)

        def slope(step: Number) -> tuple[Number, Number]:
            place = self._place([x + step * rate for x, rate in zip(residual, rates, strict=True)])
            outward = dot(place.across, across_rates)
            first = dot(place.pressed, [normal_rate, *across_rates])
            second = (
                place.bend_normal * (normal_rate * normal_rate)
                + place.bend_mixed * (2.0 * normal_rate * outward)
                + place.bend_around * (outward * outward)
                + place.share * across_squared
            )
            return self._unit_stiffness * first, self._unit_stiffness * second

        return slope

    def cost(self, residual: Vector) -> Number:
        pressed = self._place(residual).pressed
        return 0.5 * self._unit_stiffness * dot(pressed, pressed)

    def cost_decrease(self, before: Vector, after: Vector) -> Number:
        pairs = zip(self._place(before).pressed, self._place(after).pressed, strict=True)
        return 0.5 * self._unit_stiffness * total((x - y) * (x + y) for x, y in pairs)

    @property
    def _scales(self) -> Vector:
        """By direction: what makes the cone one of all directions alike."""
        return [self.slope_of_cone, *self.friction]

    @property
    def _unit_stiffness(self) -> Number:
        return self.stiffness * (1.0 / squared(self.slope_of_cone))

    def _place(self, residual: Vector) -> "_ConePlace":
        normal, *across = [scale * x for scale, x in zip(self._scales, residual, strict=True)]
        return _place(self.slope_of_cone, normal, across)


@dataclass(frozen=True)
class _ConePlace:
    """Where a residual is, in units in which all directions have the same stiffness, of 1 here.

    across: all but the normal. pressed: from the nearest residual that costs nothing to this one; share: of
    `across` in it. bend_*: second derivatives of half its square, by the normal, by the normal and `across`,
    and twice by `across`, besides `share` in each direction.
    """

    across: Vector
    pressed: Vector
    share: Number
    bend_normal: Number
    bend_mixed: Number
    bend_around: Number


def _place(slope: Number, normal: Number, across: Vector) -> _ConePlace:
    """Above the cone nothing presses, below its polar all does, and between what is outside the cone."""
    length = sqrt(maximum(dot(across, across), _SMALLEST))
    inverse, width = 1.0 / length, 1.0 / (1.0 + squared(slope))
    is_above, is_below = ~(normal < slope * length), ~(-length < slope * normal)

    def chosen(below: Number, between: Number) -> Number:
        return select(is_above, 0.0, select(is_below, below, between))

    outside = width * (normal - slope * length)
    share = chosen(1.0, -slope * (outside * inverse))
    return _ConePlace(
        across=across,
        pressed=[chosen(normal, outside), *(share * x for x in across)],
        share=share,
        bend_normal=chosen(1.0, width),
        bend_mixed=chosen(0.0, -slope * width * inverse),
        bend_around=chosen(0.0, slope * width * (normal * (inverse * inverse * inverse))),
    )
