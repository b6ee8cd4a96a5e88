"""Products with the rows of contacts in slots; see `rows` for those that are written out one by one.

The residual and its rates lie in the slots. Motions of bodies are carried from the root to the leaves, forces
and the curvature of contacts with what stands still from the leaves to the root, as in `body_rows`. The
curvature of a contact of two bodies that move is summed entry by entry, in `slot_ties`.
"""

from collections.abc import Callable, Sequence

from mujoco_compiled.constraints import body_rows
from mujoco_compiled.constraints.contact_slots import Slot
from mujoco_compiled.constraints.contact_tables import ContactTables
from mujoco_compiled.constraints.slot_ties import Ties
from mujoco_compiled.program.arithmetic import (
    Number,
    Vector,
    add,
    dot,
    maximum,
    scale,
    select,
    subtract,
    total,
)
from mujoco_compiled.program.memory import Column, array
from mujoco_compiled.program.program import Program
from mujoco_compiled.smooth.tree import Tree

_BEND = 21


class SlotRows:
    """The rows of the slots that `tables` filled. axes: by degree of freedom, [6]; see `Motion`."""

    def __init__(self, program: Program, tree: Tree, tables: ContactTables, axes: Sequence[Vector]) -> None:
        self._program, self._tree, self._kinds, self._axes = program, tree, tables.kinds, axes
        self._bodies = tables.moved
        single = [one for kind in self._kinds if not kind.is_double for one in kind.contacts]
        self._alone = sorted({body for one in single for body in one.bodies if body})
        num_bodies = len(tree.bodies)
        self._motions = array(program, "motions", num_bodies, 6)
        self._wrenches = array(program, "wrenches", num_bodies, 6)
        self._bends = array(program, "bends", num_bodies, _BEND)
        self._ties = Ties(program, tree, [kind for kind in self._kinds if kind.is_double], axes)

    def cost(self, acceleration: Vector) -> Number:
        """Of an acceleration [nv]."""
        self._move(acceleration)
        return self._summed(lambda slot: [slot.law.cost(self._residual(slot))], 1)[0]

    def begin(self, acceleration: Vector) -> None:
        """Notes the residual of an acceleration [nv]."""
        self._move(acceleration)
        self._do(lambda slot: slot.store("residual", self._residual(slot)))

    def newton(self, num_dofs: int) -> tuple[Vector, body_rows.Terms]:
        """The forces on degrees of freedom [nv] at the residual, and terms of their curvature."""
        for body in self._bodies:
            self._wrenches.store(body, [0.0] * 6)
        for body in self._alone:
            self._bends.store(body, [0.0] * _BEND)
        self._do(self._press)
        wrenches = {body: [self._wrenches.row(body)] for body in self._bodies}
        bends = {body: [self._bends.row(body)] for body in self._alone}
        forces: Vector = [0.0] * num_dofs
        for i, force in body_rows.on_dofs(self._tree, self._axes, wrenches).items():
            forces[i] = force
        found = body_rows.curvature(self._tree, self._axes, bends)
        for place, entry in self._ties.taken().items():
            found.setdefault(place, []).append(entry)
        return forces, found

    def set_rates(self, direction: Vector) -> None:
        """Notes the rates at which the residual changes along a direction [nv]."""
        self._move(direction)
        self._do(lambda slot: slot.store("rates", self._along(slot)))

    def slope(self, step: Number) -> tuple[Number, Number]:
        """The first and second derivative of the cost along the rates."""
        first, second = self._summed(
            lambda slot: list(slot.law.slope(slot.read("residual"), slot.read("rates"))(step)), 2
        )
        return first, second

    def advance(self, step: Number) -> Number:
        """Moves the residual along the rates; returns by how much the cost falls."""

        def move(slot: Slot) -> Vector:
            before = slot.read("residual")
            after = add(before, scale(slot.read("rates"), step))
            slot.store("residual", after)
            return [slot.law.cost_decrease(before, after)]

        return self._summed(move, 1)[0]

    def normal_forces(self, acceleration: Vector, contacts: Sequence[Sequence[int]]) -> Vector:
        """By list of contacts: the sum of their normal forces in N under an acceleration [nv]."""
        self._move(acceleration)
        return self._by_contact(contacts, lambda slot: maximum(slot.law.forces(self._residual(slot))[0], 0.0))

    def numbers_touching(self, contacts: Sequence[Sequence[int]]) -> Vector:
        """By list of contacts: at how many points they touch."""
        return self._by_contact(contacts, lambda slot: select(slot.touches, 1.0, 0.0))

    def _press(self, slot: Slot) -> None:
        residual = slot.read("residual")
        forces = slot.law.forces(residual)
        for side in slot.sides:
            pushes = [scale(side.wrench(*axis), force) for axis, force in zip(slot.axes, forces, strict=True)]
            self._wrenches.add(side.body, [total(entries) for entries in zip(*pushes, strict=True)])
        weights = slot.law.weights(residual)
        if slot.kind.is_double:
            self._ties.add(slot, weights)
        else:
            side = slot.sides[0]
            self._bends.add(side.body, body_rows.bend([side.wrench(*axis) for axis in slot.axes], weights))

    def _move(self, vector: Vector) -> None:
        """Notes the motions of bodies that a vector [nv] gives them."""
        for body, motion in body_rows.motions(self._tree, self._axes, vector, self._bodies).items():
            if body:
                self._motions.store(body, motion)

    def _along(self, slot: Slot) -> Vector:
        motions = [(side, self._motions.row(side.body)) for side in slot.sides]
        return [
            total(dot(axis, side.at_point(motion, turns)) for side, motion in motions)
            for axis, turns in slot.axes
        ]

    def _residual(self, slot: Slot) -> Vector:
        return subtract(self._along(slot), slot.read("reference"))

    def _by_contact(self, contacts: Sequence[Sequence[int]], compute: Callable[[Slot], Number]) -> Vector:
        """By list of contacts: the sum of a number of their slots."""
        found: Vector = [0.0] * len(contacts)
        for kind in self._kinds:
            shares = [
                kind.column(f"share {number}", [float(place in own) for place in kind.places])
                for number, own in enumerate(contacts)
            ]

            def counted(slot: Slot, now: Vector, shares: Sequence[Column] = shares) -> Vector:
                number = compute(slot)
                return [x + share.at(slot.contact) * number for x, share in zip(now, shares, strict=True)]

            found = kind.each(counted, found)
        return found

    def _do(self, act: Callable[[Slot], None]) -> None:
        def body(slot: Slot, _: Vector) -> Vector:
            act(slot)
            return []

        for kind in self._kinds:
            kind.each(body)

    def _summed(self, compute: Callable[[Slot], Vector], number: int) -> Vector:
        found: Vector = [0.0] * number
        for kind in self._kinds:
            found = kind.each(lambda slot, now: add(now, compute(slot)), found)
        return found
