"""The curvature of contacts between two bodies that move, which bind branches of the tree together.

Of the degrees of freedom that move both bodies, the contact feels nothing. Those that move one of them alone
are a chain, and each two of them share an entry.
"""

from collections.abc import Sequence

from mujoco_compiled.constraints.contact_slots import Slot, SlotKind
from mujoco_compiled.constraints.contacts import Side, moved_apart
from mujoco_compiled.program.arithmetic import Matrix, Vector, dot
from mujoco_compiled.program.memory import array, column, for_each, integers
from mujoco_compiled.program.program import Place
from mujoco_compiled.smooth.matrix_loops import MatrixLoops
from mujoco_compiled.smooth.tree import Tree
from mujoco_compiled.smooth.tree_loops import TreeLoops

# Degrees of freedom in order, each with the side that it moves.
_Chain = tuple[tuple[int, int], ...]


class Ties:
    """Adds to the entries of a matrix."""

    def __init__(self, loops: TreeLoops, matrix: MatrixLoops, kinds: Sequence[SlotKind]) -> None:
        self._loops, self._matrix = loops, matrix
        self._chains = {kind: _Chains(loops, kind) for kind in kinds}

    def add(self, slot: Slot, weights: Matrix) -> None:
        """Adds a slot's curvature. weights: its law's."""
        chains = self._chains[slot.kind]
        first, length = chains.first.at(slot.contact), chains.length.at(slot.contact)

        def tie(place: Place, _: Vector) -> Vector:
            link = first + place
            dof, side = chains.dofs.at(link), chains.sides.at(link)
            moved = Side(0, chains.signs.at(link), slot.arm(side))
            motion = self._loops.axes.row(dof + 1)
            along = [dot(axis, moved.at_point(motion, turns)) for axis, turns in slot.axes]
            chains.columns.store(place, along)
            forces = [dot(row, along) for row in weights]

            def couple(other: Place, _: Vector) -> Vector:
                entry = dot(chains.columns.row(other), forces)
                self._matrix.add_at(dof, chains.dofs.at(first + other), entry)
                return []

            return for_each(self._loops.program, place + 1, couple)

        for_each(self._loops.program, length, tie)


class _Chains:
    """The chains of a kind's contacts: first and length by contact, dofs, sides and signs by link of a chain.

    columns: room for how a chain's degrees of freedom move along a contact's directions.
    """

    def __init__(self, loops: TreeLoops, kind: SlotKind) -> None:
        program, tree = loops.program, loops.tree
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


def _chain(tree: Tree, bodies: tuple[int, int]) -> _Chain:
    return tuple(sorted((dof, side) for side, own in enumerate(moved_apart(tree, bodies)) for dof in own))
