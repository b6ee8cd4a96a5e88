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
from mujoco_compiled.program.memory import Column
from mujoco_compiled.smooth.matrix_loops import MatrixLoops
from mujoco_compiled.smooth.tree_loops import TreeLoops

_BEND = 21


class SlotRows:
    """The rows of the slots that `tables` filled. matrix: takes their curvature."""

    def __init__(self, loops: TreeLoops, matrix: MatrixLoops, tables: ContactTables) -> None:
        self._loops, self.matrix, self._kinds = loops, matrix, tables.kinds
        size = len(loops.tree.dofs)
        self._wrenches = loops.room("wrenches", size + 1, 6)
        self._bends = loops.bends
        self._ties = Ties(loops, matrix, [kind for kind in self._kinds if kind.is_double])

    def cost(self, acceleration: Vector) -> Number:
        """Of an acceleration [nv]."""
        self._loops.move(acceleration)
        return self._summed(lambda slot: [slot.law.cost(self._residual(slot))], 1)[0]

    def begin(self, acceleration: Vector) -> None:
        """Notes the residual of an acceleration [nv]."""
        self._loops.move(acceleration)
        self._do(lambda slot: slot.store("residual", self._residual(slot)))

    def newton(self) -> Vector:
        """The forces on degrees of freedom [nv] at the residual; adds their curvature to the matrix."""
        self._loops.clear(self._wrenches)
        self._loops.clear(self._bends)
        self._do(self._press)
        self.matrix.add_bends(self._bends)
        return self._loops.on_dofs(self._wrenches)

    def set_rates(self, direction: Vector) -> None:
        """Notes the rates at which the residual changes along a direction [nv]."""
        self._loops.move(direction)
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
        self._loops.move(acceleration)
        return self._by_contact(contacts, lambda slot: maximum(slot.law.forces(self._residual(slot))[0], 0.0))

    def numbers_touching(self, contacts: Sequence[Sequence[int]]) -> Vector:
        """By list of contacts: at how many points they touch."""
        return self._by_contact(contacts, lambda slot: select(slot.touches, 1.0, 0.0))

    def pulled(self, contacts: Sequence[int]) -> Vector:
        """On degrees of freedom [nv]: a force of 1 N that draws these contacts' geoms together, in equal
        parts at the points where they touch."""
        self._loops.clear(self._wrenches)
        for kind in self._kinds:
            share = kind.column("share 0", [float(place in contacts) for place in kind.places])

            def pull(slot: Slot, _: Vector, share: Column = share) -> Vector:
                normal, weight = slot.read("normal"), select(slot.touches, share.at(slot.contact), 0.0)
                for side in slot.sides:
                    self._wrenches.add(side.body, scale(side.wrench(normal, turns=False), -weight))
                return []

            kind.each(pull)
        number = maximum(self.numbers_touching([contacts])[0], 1.0)
        return [x / number for x in self._loops.on_dofs(self._wrenches)]

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

    def _along(self, slot: Slot) -> Vector:
        motions = [(side, self._loops.motions.row(side.body)) for side in slot.sides]
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
