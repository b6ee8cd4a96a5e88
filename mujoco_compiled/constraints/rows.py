"""The rows of the constraint problem in a state, and products with them.

Rows come in groups that push along a few directions by a law of their own: the four edges of a friction
pyramid mix its normal and two tangents. Products go through the directions, which takes fewer operations.
A group that pushes in no environment of a vector costs nothing: its numbers are 0.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

from mujoco_compiled.constraints import body_rows
from mujoco_compiled.constraints.body_rows import BodyGroup
from mujoco_compiled.constraints.laws import RowGroup, Slope
from mujoco_compiled.constraints.slot_rows import SlotRows
from mujoco_compiled.program.arithmetic import Number, Vector, dot, scale, total
from mujoco_compiled.program.flow import nothing, where_needed
from mujoco_compiled.smooth.tree import Tree


@dataclass(frozen=True)
class ConstraintRows:
    """axes: by degree of freedom, [6], in this state; see `Motion`. distances: in m, between geoms at each of
    the points where they can touch, of which the last groups are. slots: the contacts, if they have some."""

    groups: Sequence[RowGroup | BodyGroup]
    tree: Tree
    axes: Sequence[Vector]
    distances: Sequence[Number]
    slots: SlotRows | None = None


def times(rows: ConstraintRows, vector: Vector) -> Vector:
    """A vector [nv] along all directions."""
    return _joined(_along(rows, vector, lambda group, moved: moved))


def residual(rows: ConstraintRows, acceleration: Vector) -> Vector:
    """An acceleration [nv] along all directions, less the reference."""

    def less(group: RowGroup | BodyGroup, moved: Vector) -> Vector:
        return [x - wanted for x, wanted in zip(moved, group.reference, strict=True)]

    return _joined(_along(rows, acceleration, less))


def pulled_back(rows: ConstraintRows, forces: Vector, num_dofs: int) -> Vector:
    """Forces along all directions, as forces on the degrees of freedom [nv]."""
    terms: list[list[Number]] = [[] for _ in range(num_dofs)]
    wrenches: dict[int, list[Vector]] = {}
    for bundle in _bundles(rows):
        group = bundle.groups[0]
        if isinstance(group, BodyGroup):
            wrenches.setdefault(group.body, []).append(_computed(bundle, _wrench, forces))
            continue
        for i, force in zip(group.directions[0], _computed(bundle, _on_dofs, forces), strict=True):
            terms[i].append(force)
    for i, force in body_rows.on_dofs(rows.tree, rows.axes, wrenches).items():
        terms[i].append(force)
    return [total(own) for own in terms]


def forces(rows: ConstraintRows, residual: Vector) -> Vector:
    """How hard the rows push along all directions."""
    return _joined(
        _computed(bundle, lambda group, own: group.law.forces(own), residual, summed=False)
        for bundle in _bundles(rows)
    )


def curvature(rows: ConstraintRows, residual: Vector) -> body_rows.Terms:
    """Jᵀ H J, with the second derivatives H of the rows' cost: terms of its lower triangle's entries."""
    bends: dict[int, list[Vector]] = {}
    found = body_rows.Terms()
    for bundle in _bundles(rows):
        group = bundle.groups[0]
        if isinstance(group, BodyGroup):
            bends.setdefault(group.body, []).append(_computed(bundle, _bend, residual))
            continue
        entries = _computed(bundle, _entries, residual)
        for place, entry in zip(lower_triangle(group), entries, strict=True):
            found.setdefault(place, []).append(entry)
    for place, terms in body_rows.curvature(rows.tree, rows.axes, bends).items():
        found.setdefault(place, []).extend(terms)
    return found


def cost(rows: ConstraintRows, residual: Vector) -> Number:
    """The cost of all rows."""
    return total(
        _computed(bundle, lambda group, own: [group.law.cost(own)], residual)[0] for bundle in _bundles(rows)
    )


def cost_decrease(rows: ConstraintRows, before: Vector, after: Vector) -> Number:
    """cost(before) - cost(after), computed without cancellation."""
    return total(
        _computed(bundle, lambda group, own, then: [group.law.cost_decrease(own, then)], before, after)[0]
        for bundle in _bundles(rows)
    )


def slope(rows: ConstraintRows, residual: Vector, rates: Vector) -> Slope:
    """The slope of the cost where the residual changes at these rates."""
    always, at_times = list[Slope](), list[_Bundle]()
    for bundle in _bundles(rows):
        if bundle.may_push is not True:
            at_times.append(bundle)
            continue
        for group, own, rate in bundle.parts(residual, rates):
            always.append(group.law.slope(own, rate))

    def summed(step: Number) -> tuple[Number, Number]:
        found = [
            *(one(step) for one in always),
            *(
                _computed(bundle, lambda group, own, rate: group.law.slope(own, rate)(step), residual, rates)
                for bundle in at_times
            ),
        ]
        return total(first for first, _ in found), total(second for _, second in found)

    return summed


def by_group(rows: ConstraintRows, values: Sequence[Number]) -> Iterator[tuple[RowGroup | BodyGroup, Vector]]:
    """Each group with its own part of a number for each direction."""
    place = 0
    for group in rows.groups:
        end = place + group.size
        yield group, list(values[place:end])
        place = end


@dataclass(frozen=True)
class _Bundle:
    """Groups that push together, such as a contact's points. first: the place of their first direction."""

    groups: Sequence[RowGroup | BodyGroup]
    first: int

    @property
    def may_push(self) -> Number:
        return self.groups[0].may_push

    def parts(self, *vectors: Vector) -> Iterator[tuple[RowGroup | BodyGroup, *tuple[Vector, ...]]]:
        """Each group with its own parts of numbers for each direction."""
        place = self.first
        for group in self.groups:
            end = place + group.size
            yield group, *(vector[place:end] for vector in vectors)
            place = end


def _bundles(rows: ConstraintRows) -> Iterator[_Bundle]:
    place = 0
    for _, several in groupby(rows.groups, _what_decides):
        groups = list(several)
        yield _Bundle(groups, place)
        place += sum(group.size for group in groups)


def _what_decides(group: RowGroup | BodyGroup) -> int:
    """The same for groups that push together."""
    return id(group if group.may_push is True else group.may_push)


def _computed(
    bundle: _Bundle, compute: Callable[..., Sequence[Number]], *vectors: Vector, summed: bool = True
) -> Vector:
    """The numbers of the bundle's groups: each one's sum over the groups, or one group's after the other."""

    def compute_all() -> Vector:
        found = [compute(*part) for part in bundle.parts(*vectors)]
        return [total(own) for own in zip(*found, strict=True)] if summed else _joined(found)

    return where_needed(bundle.may_push, compute_all, nothing)


def _along(
    rows: ConstraintRows, vector: Vector, compute: Callable[[RowGroup | BodyGroup, Vector], Vector]
) -> Iterator[Vector]:
    """By bundle: numbers of a vector [nv] along each direction."""
    bodies = [group.body for group in rows.groups if isinstance(group, BodyGroup)]
    motions = body_rows.motions(rows.tree, rows.axes, vector, bodies)

    def moved(group: RowGroup | BodyGroup) -> Vector:
        if isinstance(group, BodyGroup):
            return compute(group, [dot(wrench, motions[group.body]) for wrench in group.wrenches])
        return compute(group, [total(x * vector[i] for i, x in one.items()) for one in group.directions])

    for bundle in _bundles(rows):
        yield _computed(bundle, moved, summed=False)


def _wrench(group: BodyGroup, forces: Vector) -> Vector:
    pushes = [scale(one, force) for one, force in zip(group.wrenches, forces, strict=True)]
    return [total(entries) for entries in zip(*pushes, strict=True)]


def _on_dofs(group: RowGroup, forces: Vector) -> Vector:
    """By degree of freedom, in the directions' order."""
    pairs = list(zip(group.directions, forces, strict=True))
    return [total(direction[i] * force for direction, force in pairs) for i in group.directions[0]]


def _bend(group: BodyGroup, residual: Vector) -> Vector:
    return body_rows.bend(group.wrenches, group.law.weights(residual))


def _entries(group: RowGroup, residual: Vector) -> Vector:
    """The entries of the lower triangle."""
    weights = group.law.weights(residual)
    columns = {i: [direction[i] for direction in group.directions] for i in group.directions[0]}
    along = {i: [dot(row, column) for row in weights] for i, column in columns.items()}
    return [dot(columns[j], along[i]) for i, j in lower_triangle(group)]


def lower_triangle(group: RowGroup) -> list[tuple[int, int]]:
    """The entries of a matrix over degrees of freedom that the group adds to."""
    dofs = list(group.directions[0])
    return [(i, j) for i in dofs for j in dofs if j <= i]


def _joined(parts: Iterable[Sequence[Number]]) -> Vector:
    return [number for part in parts for number in part]
