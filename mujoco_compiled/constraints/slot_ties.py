"""The curvature of contacts between two bodies that move, which bind branches of the tree together.

Of the degrees of freedom that move both bodies, the contact feels nothing. Those that move one of them alone
are a chain, and each two of them share an entry.
"""

from collections.abc import Sequence

from mujoco_compiled.constraints.contact_slots import Slot, SlotKind
from mujoco_compiled.constraints.contacts import Side, moved_apart
from mujoco_compiled.program.arithmetic import Matrix, Number, Vector, dot
from mujoco_compiled.program.memory import array, column, for_each, integers
from mujoco_compiled.program.program import Place, Program
from mujoco_compiled.smooth.tree import Tree

# Degrees of freedom in order, each with the side that it moves.
_Chain = tuple[tuple[int, int], ...]


class Ties:
    """Entries of the matrix that several contacts add to. axes: by degree of freedom, [6], in this state."""

    def __init__(
        self, program: Program, tree: Tree, kinds: Sequence[SlotKind], axes: Sequence[Vector]
    ) -> None:
        self._program, self._num_dofs = program, len(tree.dofs)
        self._chains = {kind: _Chains(program, tree, kind) for kind in kinds}
        self._coupled = sorted({pair for chains in self._chains.values() for pair in chains.coupled})
        self._axes = array(program, "axes", self._num_dofs, 6)
        self._entries = array(program, "entries of ties", self._num_dofs**2)
        if kinds:
            for dof, axis in enumerate(axes):
                self._axes.store(dof, axis)
            for_each(program, self._num_dofs**2, lambda place, _: self._clear(place))

    def add(self, slot: Slot, weights: Matrix) -> None:
        """Adds a slot's curvature. weights: its law's."""
        chains = self._chains[slot.kind]
        first, length = chains.first.at(slot.contact), chains.length.at(slot.contact)

        def tie(place: Place, _: Vector) -> Vector:
            link = first + place
            dof, side = chains.dofs.at(link), chains.sides.at(link)
            moved = Side(0, chains.signs.at(link), slot.arm(side))
            column_ = [dot(axis, moved.at_point(self._axes.row(dof), turns)) for axis, turns in slot.axes]
            chains.columns.store(place, column_)
            forces = [dot(row, column_) for row in weights]

            def couple(other: Place, _: Vector) -> Vector:
                entry = dof * self._num_dofs + chains.dofs.at(first + other)
                self._entries.add(entry, [dot(chains.columns.row(other), forces)])
                return []

            return for_each(self._program, place + 1, couple)

        for_each(self._program, length, tie)

    def taken(self) -> dict[tuple[int, int], Number]:
        """The entries of the lower triangle, which are 0 from then on."""
        found = dict[tuple[int, int], Number]()
        for i, j in self._coupled:
            place = i * self._num_dofs + j
            found[i, j] = self._entries.row(place)[0]
            self._entries.store(place, [0.0])
        return found

    def _clear(self, place: Place) -> Vector:
        self._entries.store(place, [0.0])
        return []


class _Chains:
    """The chains of a kind's contacts: first and length by contact, dofs, sides and signs by link of a chain.

    columns: room for how a chain's degrees of freedom move along a contact's directions.
    """

    def __init__(self, program: Program, tree: Tree, kind: SlotKind) -> None:
        of_contacts = [_chain(tree, contact.bodies) for contact in kind.contacts]
        chains = list(dict.fromkeys(of_contacts))
        begins = {chain: sum(map(len, chains[:number])) for number, chain in enumerate(chains)}
        links = [link for chain in chains for link in chain]
        self.first = kind.integers("chains' begins", [begins[chain] for chain in of_contacts])
        self.length = kind.integers("chains' lengths", [len(chain) for chain in of_contacts])
        self.dofs = integers(program, f"{kind.name} chains' dofs", [dof for dof, _ in links])
        self.sides = integers(program, f"{kind.name} chains' sides", [side for _, side in links])
        self.signs = column(program, f"{kind.name} chains' signs", [(-1.0, 1.0)[side] for _, side in links])
        self.columns = array(program, f"{kind.name} columns", max(map(len, chains)), kind.num_directions)
        self.coupled = {(i, j) for chain in chains for i, _ in chain for j, _ in chain if j <= i}


def _chain(tree: Tree, bodies: tuple[int, int]) -> _Chain:
    return tuple(sorted((dof, side) for side, own in enumerate(moved_apart(tree, bodies)) for dof in own))
