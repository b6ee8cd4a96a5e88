"""Finds where geoms touch, by loops over tables of pairs, and fills the slots of `contact_slots`."""

from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import replace
from typing import Any

from mujoco_compiled.collisions.prisms import Window
from mujoco_compiled.collisions.shapes import Geom, Placed, Touch
from mujoco_compiled.collisions.table import COLLIDERS, GAPS
from mujoco_compiled.constraints.contact_room import Room
from mujoco_compiled.constraints.contact_slots import Slot, SlotKind
from mujoco_compiled.constraints.contacts import ContactPair, Side, are_close, push
from mujoco_compiled.constraints.pairs import ContactParameters
from mujoco_compiled.program.arithmetic import (
    Matrix,
    Number,
    Vector,
    add,
    product,
    rotate,
    subtract,
)
from mujoco_compiled.program.memory import array, column, for_each, integers, rows, where_any
from mujoco_compiled.program.program import Place, Program
from mujoco_compiled.smooth.dynamics import Motion
from mujoco_compiled.smooth.kinematics import Poses
from mujoco_compiled.smooth.tree_loops import TreeLoops

# In m, more than rounding and a search without end can make of a distance.
_ROUNDING = 1e-4
_UNTURNED = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]


class ContactTables:
    """The contacts of a model as tables of a program. kinds: of slots."""

    def __init__(self, loops: TreeLoops, contacts: Sequence[ContactPair], room: Room) -> None:
        program = loops.program
        self._program, self._loops = program, loops
        self._geoms = _GeomTable(program, contacts)
        places = {id(contact): place for place, contact in enumerate(contacts)}
        groups = [_joined(_alike(own, _looks_of_loops)) for own in _alike(contacts, lambda one: one.looks)]
        self.kinds = [
            SlotKind(loops, f"contacts {number}", own, [places[id(contact)] for contact in own], room(own[0]))
            for number, own in enumerate(groups)
        ]
        self._searches = [
            _Loop(kind, number, own, self._geoms)
            for kind in self.kinds
            for number, own in enumerate(_alike(kind.contacts, _looks_of_loops))
        ]
        moved = {body for contact in contacts for body in contact.bodies if body}
        # By row, a body that is there.
        self._moved = {loops.rows[body]: body for body in sorted(moved)}
        self._centres = array(program, "centres", len(loops.tree.dofs) + 1, 3)

    def fill(self, at: Poses, moving: Motion) -> None:
        """Puts the points that touch in this state to slots."""
        for row, body in self._moved.items():
            self._centres.store(row, moving.centres[self._loops.tree.bodies[body].root])
        self._geoms.place(at)
        for kind in self.kinds:
            kind.slots.clear()
        for loop in self._searches:
            self._search(loop)

    def _search(self, loop: "_Loop") -> None:
        """First notes which pairs are close, and of these, which may touch: the threads of a warp then have
        their own ones side by side."""

        def look(row: Place, _: Vector) -> Vector:
            where_any(loop.are_close(row), lambda: loop.close.append(row))
            return []

        def look_again(number: Place, _: Vector) -> Vector:
            row = loop.close.at(number)
            where_any(loop.may_touch(row), lambda: loop.close.append(row))
            return []

        def touch(number: Place, _: Vector) -> Vector:
            self._touch(loop, loop.close.at(number))
            return []

        loop.close.clear()
        for_each(self._program, len(loop.contacts), look)
        if loop.gap:
            # In place: a row goes to where it was, or before.
            for_each(self._program, loop.close.restart(), look_again)
        for_each(self._program, loop.close.length(), touch)

    def _touch(self, loop: "_Loop", row: Place) -> None:
        contact = loop.contact(row)
        one, other = (geom(row) for geom in loop.geoms)
        if loop.window is not None:
            reach = contact.parameters.reach
            loop.window.each_touch(
                loop.first.other.kind, one, other, reach, lambda touch: self._put(loop, row, contact, touch)
            )
            return
        collide, _ = COLLIDERS[loop.first.kinds]
        for touch in collide(one, other):
            self._put(loop, row, contact, touch)

    def _put(self, loop: "_Loop", row: Place, contact: ContactPair, touch: Touch) -> None:
        """The point to a slot, where it touches."""
        touches = touch.distance < contact.parameters.reach
        where_any(touches, lambda: self._fill(loop, row, contact, touch))

    def _fill(self, loop: "_Loop", row: Place, contact: ContactPair, touch: Touch) -> None:
        kind, place = loop.kind, row + loop.begin
        slot = Slot(kind, kind.slots.append(place))
        bodies = [own.at(place) for own in kind.bodies]
        sides = [
            Side(body, sign, subtract(touch.position, self._centres.row(body)))
            for body, sign in zip(bodies, kind.signs, strict=True)
        ]
        found = push(contact, touch, [(side, self._loops.velocities.row(side.body)) for side in sides])
        frame = [axis for axis, _ in found.axes]
        slot.store("normal", frame[0])
        if kind.num_directions > 1:
            slot.store("tangent", frame[1])
        slot.store("arms", [x for side in sides for x in side.arm])
        slot.store("distance", [touch.distance])
        slot.store("stiffness", [found.law.stiffness])
        slot.store("reference", found.reference)


class _GeomTable:
    """The geoms that can touch. rows: by their numbers."""

    def __init__(self, program: Program, contacts: Sequence[ContactPair]) -> None:
        geoms = {one.number: one for contact in contacts for one in (contact.one, contact.other)}
        self._program, self._geoms = program, list(geoms.values())
        self.rows = {number: row for row, number in enumerate(geoms)}
        self._bodies = sorted({geom.body for geom in self._geoms})
        self._body = integers(program, "geoms' bodies", [geom.body for geom in self._geoms])
        self._local = self._columns("places", [[*one.position, *_flat(one.rotation)] for one in self._geoms])
        self._sizes = self._columns("sizes", [one.size for one in self._geoms])
        # A position [3] and a rotation [9] in the world.
        self._frames = array(program, "bodies' frames", 1 + max(self._bodies), 12)
        self._placed = array(program, "geoms' frames", len(self._geoms), 12)

    def place(self, at: Poses) -> None:
        """Notes where the geoms are in this state."""
        for body in self._bodies:
            self._frames.store(body, [*at.positions[body], *_flat(at.rotations[body])])
        for_each(self._program, len(self._geoms), lambda row, _: self._place(row))

    def placed(self, row: Place, like: Geom) -> Placed:
        """like: a geom whose hull and height field the rows of one loop share."""
        frame, size = self._placed.row(row), [column.at(row) for column in self._sizes]
        return Placed(frame[:3], _square(frame[3:]), _UNTURNED, size, like.hull, like.field)

    def _place(self, row: Place) -> Vector:
        frame, local = self._frames.row(self._body.at(row)), [column.at(row) for column in self._local]
        to_world = _square(frame[3:])
        position = add(frame[:3], rotate(to_world, local[:3]))
        self._placed.store(row, [*position, *_flat(product(to_world, _square(local[3:])))])
        return []

    def _columns(self, name: str, values: Sequence[Vector]) -> list[Any]:
        columns = zip(*values, strict=True)
        return [column(self._program, f"geoms' {name} {k}", own) for k, own in enumerate(columns)]


class _Loop:
    """Contacts whose points one routine finds. begin: the row of the first among those of `kind`.

    close: rows of geoms that may touch in this state. gap: see `GAPS`.
    """

    def __init__(
        self, kind: SlotKind, number: int, contacts: Sequence[ContactPair], geoms: _GeomTable
    ) -> None:
        self.kind, self.contacts, self.first = kind, contacts, contacts[0]
        self.begin = next(row for row, one in enumerate(kind.contacts) if one is self.first)
        self.close = rows(kind.program, f"{kind.name} {number} close", len(contacts))
        self.gap = GAPS.get(self.first.kinds)
        self._rows = [
            integers(kind.program, f"{kind.name} {number} geoms {k}", [geoms.rows[one.number] for one in own])
            for k, own in enumerate(zip(*((one.one, one.other) for one in contacts), strict=True))
        ]
        self._columns = {
            name: column(kind.program, f"{kind.name} {number} {name}", [read(one) for one in contacts])
            for name, read in _COLUMNS.items()
        }
        self.geoms = [
            lambda row, own=own, like=like: geoms.placed(own.at(row), like)
            for own, like in zip(self._rows, (self.first.one, self.first.other), strict=True)
        ]
        size = self.first.window
        self.window = size and Window(kind.program, f"{kind.name} {number}", size)

    def contact(self, row: Place) -> ContactPair:
        """The contact with the numbers of a row."""
        at = {name: own.at(row) for name, own in self._columns.items()}
        first = self.first.parameters
        friction = [one.at(row + self.begin) for one in self.kind.friction]
        spring = replace(first.spring, stiffness=at["stiffness"], damping=at["damping"])
        parameters = ContactParameters(
            tuple(friction), spring, at["margin"], at["reach"], at["friction_damping"]
        )
        return replace(self.first, parameters=parameters, inverse_weight=at["inverse_weight"])

    def are_close(self, row: Place) -> Number:
        """Whether the geoms are near enough for them to touch; see `contacts.are_close`."""
        at = {name: own.at(row) for name, own in self._columns.items()}
        contact = replace(
            self.first,
            one=replace(self.first.one, bound=at["bound"]),
            other=replace(self.first.other, bound=at["bound_other"]),
            parameters=replace(self.first.parameters, reach=at["reach"]),
        )
        return are_close(contact, *(geom(row) for geom in self.geoms))

    def may_touch(self, row: Place) -> Number:
        """Whether the gap between the geoms is small enough."""
        assert self.gap is not None  # noqa: S101
        return self.gap(*(geom(row) for geom in self.geoms)) < self._columns["reach"].at(row) + _ROUNDING


_COLUMNS: dict[str, Callable[[ContactPair], Number]] = {
    "stiffness": lambda one: one.parameters.spring.stiffness,
    "damping": lambda one: one.parameters.spring.damping,
    "friction_damping": lambda one: one.parameters.friction_damping,
    "margin": lambda one: one.parameters.margin,
    "reach": lambda one: one.parameters.reach,
    "inverse_weight": lambda one: one.inverse_weight,
    "bound": lambda one: one.one.bound,
    "bound_other": lambda one: one.other.bound,
}


def _looks_of_loops(contact: ContactPair) -> Hashable:
    """Alike for contacts whose points one routine finds."""
    meshes = [geom.hull and geom.hull.mesh for geom in (contact.one, contact.other)]
    field = contact.one.field and contact.one.field.number
    return contact.kinds, contact.parameters.spring.impedance, *meshes, field, contact.window


def _alike(
    contacts: Sequence[ContactPair], looks: Callable[[ContactPair], Hashable]
) -> list[list[ContactPair]]:
    groups: dict[Hashable, list[ContactPair]] = {}
    for contact in contacts:
        groups.setdefault(looks(contact), []).append(contact)
    return list(groups.values())


def _joined(groups: Iterable[list[ContactPair]]) -> list[ContactPair]:
    return [contact for group in groups for contact in group]


def _flat(matrix: Matrix) -> Vector:
    return [x for row in matrix for x in row]


def _square(values: Vector) -> Matrix:
    return [values[:3], values[3:6], values[6:]]
