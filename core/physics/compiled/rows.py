"""The rows of the constraint problem in a state, and products with them.

Rows come in groups whose entries are mixtures of a few directions: the four edges of a friction pyramid are
the normal plus or minus the friction times each of two tangents. Products go through the directions, which
takes fewer operations.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from core.physics.compiled.arithmetic import Number, Vector, dot, minimum, select, total
from core.physics.compiled.dynamics import Entries

# How a motion of each degree of freedom that matters moves along it.
Direction = dict[int, Number]


@dataclass(frozen=True)
class Group:
    """mixtures: by row, a coefficient for each direction. The directions have the same degrees of freedom.

    stiffness: by row, MuJoCo's `efc_D`, 0 where the row is not active. reference: by row, the wanted
    acceleration, `efc_aref`.
    """

    directions: Sequence[Direction]
    mixtures: Sequence[Sequence[float]]
    stiffness: Vector
    reference: Vector


Rows = Sequence[Group]


def stiffness_of(rows: Rows) -> Vector:
    """D, [rows]."""
    return [value for group in rows for value in group.stiffness]


def times(rows: Rows, vector: Vector) -> Vector:
    """J times a vector [nv]: [rows]."""
    found: Vector = []
    for group in rows:
        along = [total(entry * vector[i] for i, entry in one.items()) for one in group.directions]
        found += [dot(mixture, along) for mixture in group.mixtures]
    return found


def residual(rows: Rows, acceleration: Vector) -> Vector:
    """J times an acceleration [nv], less the reference: [rows]. Rows push where it is below 0."""
    wanted = (value for group in rows for value in group.reference)
    return [x - a for x, a in zip(times(rows, acceleration), wanted, strict=True)]


def pulled_back(rows: Rows, forces: Vector, num_dofs: int) -> Vector:
    """Jᵀ times forces [rows]: [nv]."""
    terms: list[list[Number]] = [[] for _ in range(num_dofs)]
    for group, own in zip(rows, _by_group(rows, forces), strict=True):
        for column, direction in zip(zip(*group.mixtures, strict=True), group.directions, strict=True):
            force = dot(column, own)
            for i, entry in direction.items():
                terms[i].append(entry * force)
    return [total(own) for own in terms]


def forces(rows: Rows, residual: Vector) -> Vector:
    """How hard the rows push: [rows]."""
    return [-d * minimum(x, 0.0) for d, x in zip(stiffness_of(rows), residual, strict=True)]


def curvature(rows: Rows, residual: Vector) -> dict[tuple[int, int], list[Number]]:
    """Jᵀ D J over the rows that push: terms of its lower triangle's entries."""
    found: dict[tuple[int, int], list[Number]] = {}
    for group, own in zip(rows, _by_group(rows, residual), strict=True):
        active = [select(x < 0.0, d, 0.0) for d, x in zip(group.stiffness, own, strict=True)]
        columns = list(zip(*group.mixtures, strict=True))
        weights = [[_weight(active, one, other) for other in columns] for one in columns]
        dofs = list(group.directions[0])
        weighted = {
            i: [dot(row, [direction[i] for direction in group.directions]) for row in weights] for i in dofs
        }
        for i in dofs:
            for j in dofs:
                if j <= i:
                    entry = dot([direction[j] for direction in group.directions], weighted[i])
                    found.setdefault((i, j), []).append(entry)
    return found


def _weight(active: Vector, one: Sequence[float], other: Sequence[float]) -> Number:
    return total(a * (x * y) for a, x, y in zip(active, one, other, strict=True) if x and y)


def _by_group(rows: Rows, values: Vector) -> list[Vector]:
    found, place = list[Vector](), 0
    for group in rows:
        found.append(values[place : place + len(group.mixtures)])
        place += len(group.mixtures)
    return found


def added(mass: Entries, terms: dict[tuple[int, int], list[Number]]) -> Entries:
    """M plus terms of its own entries."""
    return {place: total([entry, *terms.get(place, [])]) for place, entry in mass.items()}
