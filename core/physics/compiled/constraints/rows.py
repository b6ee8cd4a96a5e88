"""The rows of the constraint problem in a state, and products with them.

Rows come in groups that push along a few directions by a law of their own: the four edges of a friction
pyramid mix its normal and two tangents. Products go through the directions, which takes fewer operations.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from core.physics.compiled.constraints import body_rows
from core.physics.compiled.constraints.body_rows import BodyGroup
from core.physics.compiled.constraints.laws import Law, Slope
from core.physics.compiled.program.arithmetic import Number, Vector, dot, scale, total
from core.physics.compiled.smooth.dynamics import Entries
from core.physics.compiled.smooth.tree import Tree

# How a motion of each degree of freedom that matters moves along it.
Direction = dict[int, Number]


@dataclass(frozen=True)
class Group:
    """The directions have the same degrees of freedom. reference: by direction, the wanted acceleration."""

    directions: Sequence[Direction]
    reference: Vector
    law: Law

    @property
    def size(self) -> int:
        """The number of directions."""
        return len(self.directions)


@dataclass(frozen=True)
class Rows:
    """axes: by degree of freedom, [6], in this state; see `Motion`. distances: in m, between geoms at each of
    the points where they can touch, of which the last groups are."""

    groups: Sequence[Group | BodyGroup]
    tree: Tree
    axes: Sequence[Vector]
    distances: Sequence[Number]


def times(rows: Rows, vector: Vector) -> Vector:
    """A vector [nv] along all directions."""
    bodies = [group.body for group in rows.groups if isinstance(group, BodyGroup)]
    motions = body_rows.motions(rows.tree, rows.axes, vector, bodies)
    found: Vector = []
    for group in rows.groups:
        if isinstance(group, BodyGroup):
            found += [dot(wrench, motions[group.body]) for wrench in group.wrenches]
        else:
            found += [total(x * vector[i] for i, x in one.items()) for one in group.directions]
    return found


def residual(rows: Rows, acceleration: Vector) -> Vector:
    """An acceleration [nv] along all directions, less the reference."""
    wanted = (value for group in rows.groups for value in group.reference)
    return [x - a for x, a in zip(times(rows, acceleration), wanted, strict=True)]


def pulled_back(rows: Rows, forces: Vector, num_dofs: int) -> Vector:
    """Forces along all directions, as forces on the degrees of freedom [nv]."""
    terms: list[list[Number]] = [[] for _ in range(num_dofs)]
    wrenches: dict[int, list[Vector]] = {}
    for group, own in by_group(rows, forces):
        if isinstance(group, BodyGroup):
            pushes = [scale(one, force) for one, force in zip(group.wrenches, own, strict=True)]
            wrenches.setdefault(group.body, []).extend(pushes)
            continue
        for direction, force in zip(group.directions, own, strict=True):
            for i, entry in direction.items():
                terms[i].append(entry * force)
    for i, force in body_rows.on_dofs(rows.tree, rows.axes, wrenches).items():
        terms[i].append(force)
    return [total(own) for own in terms]


def forces(rows: Rows, residual: Vector) -> Vector:
    """How hard the rows push along all directions."""
    return [force for group, own in by_group(rows, residual) for force in group.law.forces(own)]


def curvature(rows: Rows, residual: Vector) -> body_rows.Terms:
    """Jᵀ H J, with the second derivatives H of the rows' cost: terms of its lower triangle's entries."""
    weighted = [(group, group.law.weights(own)) for group, own in by_group(rows, residual)]
    of_bodies = [(group, weights) for group, weights in weighted if isinstance(group, BodyGroup)]
    found = body_rows.curvature(rows.tree, rows.axes, of_bodies)
    for group, weights in weighted:
        if isinstance(group, BodyGroup):
            continue
        dofs = list(group.directions[0])
        columns = {i: [direction[i] for direction in group.directions] for i in dofs}
        for i in dofs:
            along = [dot(row, columns[i]) for row in weights]
            for j in dofs:
                if j <= i:
                    found.setdefault((i, j), []).append(dot(columns[j], along))
    return found


def cost(rows: Rows, residual: Vector) -> Number:
    """Of all rows."""
    return total(group.law.cost(own) for group, own in by_group(rows, residual))


def fall(rows: Rows, before: Vector, after: Vector) -> Number:
    """By how much less the cost is after."""
    pairs = zip(by_group(rows, before), by_group(rows, after), strict=True)
    return total(group.law.fall(own, then) for (group, own), (_, then) in pairs)


def slope(rows: Rows, residual: Vector, rates: Vector) -> Slope:
    """Of the cost where the residual moves on at these rates."""
    pairs = zip(by_group(rows, residual), by_group(rows, rates), strict=True)
    slopes = [group.law.slope(own, rate) for (group, own), (_, rate) in pairs]

    def summed(step: Number) -> tuple[Number, Number]:
        at_step = [one(step) for one in slopes]
        return total(first for first, _ in at_step), total(second for _, second in at_step)

    return summed


def by_group(rows: Rows, values: Sequence[Number]) -> Iterator[tuple[Group | BodyGroup, Vector]]:
    """Each group with its own part of a number for each direction."""
    place = 0
    for group in rows.groups:
        end = place + group.size
        yield group, list(values[place:end])
        place = end


def added(mass: Entries, terms: dict[tuple[int, int], list[Number]]) -> Entries:
    """M plus terms of its own entries, and of others where rows bind branches of the tree together."""
    places: Iterable[tuple[int, int]] = dict.fromkeys([*mass, *terms])
    return {place: total([mass.get(place, 0.0), *terms.get(place, [])]) for place in places}
