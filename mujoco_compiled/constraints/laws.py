"""How rows push: the force, its curvature and the cost of a group of rows as functions of its residual.

A residual is the acceleration along each of a group's directions less the wanted one. Where rows are not
active, their stiffness is 0, and with it all that a law computes.
Source: MuJoCo's documentation, Computation, "Constraint model".
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

from mujoco_compiled.program.arithmetic import (
    Matrix,
    Number,
    Vector,
    dot,
    minimum,
    select,
    squared,
    total,
)

# How a motion of each degree of freedom that matters moves along it.
Direction = dict[int, Number]
# The cost's first and second derivative at a step along a line.
Slope = Callable[[Number], tuple[Number, Number]]


class Law(Protocol):
    """Residuals and forces: a number for each direction."""

    @property
    def stiffness(self) -> Number:
        """All that the law computes is 0 where it is."""
        ...

    def forces(self, residual: Vector) -> Vector:
        """The cost's negative gradient."""
        ...

    def weights(self, residual: Vector) -> Matrix:
        """The cost's second derivatives."""
        ...

    def slope(self, residual: Vector, rates: Vector) -> Slope:
        """How the cost changes where the residual moves on at these rates."""
        ...

    def cost(self, residual: Vector) -> Number:
        """0 where no row pushes."""
        ...

    def cost_decrease(self, before: Vector, after: Vector) -> Number:
        """cost(before) - cost(after), computed without cancellation."""
        ...


@dataclass(frozen=True)
class RowGroup:
    """The directions have the same degrees of freedom. reference: by direction, the wanted acceleration.

    may_push: in which environments the law is not 0 everywhere; True: perhaps in all.
    """

    directions: Sequence[Direction]
    reference: Vector
    law: Law
    may_push: Number = True

    @property
    def size(self) -> int:
        """The number of directions."""
        return len(self.directions)


def with_stiffness(law: Law, stiffness: Number) -> Law:
    """The same law with another stiffness. Laws are dataclasses."""
    changed: Any = law
    return replace(changed, stiffness=stiffness)


@dataclass(frozen=True)
class OneSided:
    """A limit, or a contact without friction: it pushes where its one residual is below 0."""

    stiffness: Number

    def forces(self, residual: Vector) -> Vector:
        return [-self.stiffness * minimum(residual[0], 0.0)]

    def weights(self, residual: Vector) -> Matrix:
        return [[select(residual[0] < 0.0, self.stiffness, 0.0)]]

    def slope(self, residual: Vector, rates: Vector) -> Slope:
        return _slope(self.stiffness, residual, rates)

    def cost(self, residual: Vector) -> Number:
        return 0.5 * self.stiffness * squared(minimum(residual[0], 0.0))

    def cost_decrease(self, before: Vector, after: Vector) -> Number:
        return 0.5 * self.stiffness * _fall(before[0], after[0])


@dataclass(frozen=True)
class TwoSided:
    """An equality: each of its residuals is pushed back to 0 from both sides."""

    stiffness: Number

    def forces(self, residual: Vector) -> Vector:
        return [-self.stiffness * x for x in residual]

    def weights(self, residual: Vector) -> Matrix:
        size = len(residual)
        return [[self.stiffness if i == j else 0.0 for j in range(size)] for i in range(size)]

    def slope(self, residual: Vector, rates: Vector) -> Slope:
        at_start, bend = self.stiffness * dot(residual, rates), self.stiffness * dot(rates, rates)
        return lambda step: (at_start + step * bend, bend)

    def cost(self, residual: Vector) -> Number:
        return 0.5 * self.stiffness * dot(residual, residual)

    def cost_decrease(self, before: Vector, after: Vector) -> Number:
        return 0.5 * self.stiffness * total((x - y) * (x + y) for x, y in zip(before, after, strict=True))


@dataclass(frozen=True)
class Pyramid:
    """A contact whose forces stay in a pyramid: each of its edges pushes for itself.

    The first direction is the normal. An edge is the normal plus or minus a friction [directions - 1] times
    one of the others.
    """

    stiffness: Number
    friction: Sequence[Number]

    def forces(self, residual: Vector) -> Vector:
        pressed = [minimum(edge, 0.0) for edge in self._edges(residual)]
        across = [
            -self.stiffness * (friction * (pressed[2 * k] - pressed[2 * k + 1]))
            for k, friction in enumerate(self.friction)
        ]
        return [-self.stiffness * total(pressed), *across]

    def weights(self, residual: Vector) -> Matrix:
        active = [select(edge < 0.0, self.stiffness, 0.0) for edge in self._edges(residual)]
        size = len(residual)
        found: Matrix = [[0.0] * size for _ in range(size)]
        found[0][0] = total(active)
        for k, friction in enumerate(self.friction):
            plus, minus = active[2 * k], active[2 * k + 1]
            found[0][k + 1] = found[k + 1][0] = friction * (plus - minus)
            found[k + 1][k + 1] = squared(friction) * (plus + minus)
        return found

    def slope(self, residual: Vector, rates: Vector) -> Slope:
        return _slope(self.stiffness, self._edges(residual), self._edges(rates))

    def cost(self, residual: Vector) -> Number:
        squares = total(squared(minimum(edge, 0.0)) for edge in self._edges(residual))
        return 0.5 * self.stiffness * squares

    def cost_decrease(self, before: Vector, after: Vector) -> Number:
        edges = zip(self._edges(before), self._edges(after), strict=True)
        return 0.5 * self.stiffness * total(_fall(one, other) for one, other in edges)

    def _edges(self, along: Vector) -> Vector:
        found: Vector = []
        for friction, across in zip(self.friction, along[1:], strict=True):
            found += [along[0] + friction * across, along[0] - friction * across]
        return found


def _slope(stiffness: Number, residual: Vector, rates: Vector) -> Slope:
    """The slope of rows that push where their residual is below 0."""

    # Outside of the search's loop, so that each step takes fewer operations.
    firsts = [stiffness * rate for rate in rates]
    seconds = [first * rate for first, rate in zip(firsts, rates, strict=True)]

    def slope(step: Number) -> tuple[Number, Number]:
        there = [x + step * rate for x, rate in zip(residual, rates, strict=True)]
        first = dot(firsts, [minimum(x, 0.0) for x in there])
        second = total(select(x < 0.0, second, 0.0) for x, second in zip(there, seconds, strict=True))
        return first, second

    return slope


def _fall(before: Number, after: Number) -> Number:
    """By how much less the square of what is below 0 is."""
    one, other = minimum(before, 0.0), minimum(after, 0.0)
    return (one - other) * (one + other)
