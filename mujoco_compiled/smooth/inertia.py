"""M of a substep: its products, and linear equations with it and with what is added to it."""

from collections.abc import Mapping
from typing import Protocol

from mujoco_compiled.program.arithmetic import Number, Vector, total
from mujoco_compiled.smooth.dynamics import Entries
from mujoco_compiled.smooth.factor import factorize, multiply, solve
from mujoco_compiled.smooth.matrix_loops import MatrixLoops
from mujoco_compiled.smooth.tree import Tree
from mujoco_compiled.smooth.tree_loops import TreeLoops

# Terms of entries of the lower triangle.
Terms = Mapping[tuple[int, int], list[Number]]


class Inertia(Protocol):
    @property
    def entries(self) -> Entries:
        """M's, of `Tree.entries`."""
        ...

    def multiply(self, vector: Vector) -> Vector:
        """M x [nv]."""
        ...

    def begin(self) -> None:
        """Begins a sum, which is M first."""
        ...

    def solve(self, terms: Terms, right: Vector) -> Vector:
        """x [nv] with the sum, to which these terms are added, times x = right."""
        ...


class WrittenOut:
    """Every operation for itself; terms may be beyond the tree's entries."""

    def __init__(self, tree: Tree, entries: Entries) -> None:
        self._tree, self.entries = tree, entries

    def multiply(self, vector: Vector) -> Vector:
        return multiply(self._tree, self.entries, vector)

    def begin(self) -> None:
        """M is there already."""

    def solve(self, terms: Terms, right: Vector) -> Vector:
        return solve(self._tree, factorize(self._tree, added(self.entries, terms)), right)


class InLoops:
    """In memory; `matrix` is the sum, to which contacts in slots add."""

    def __init__(self, loops: TreeLoops, matrix: MatrixLoops, entries: Entries) -> None:
        self._loops, self.matrix, self.entries = loops, matrix, entries

    def multiply(self, vector: Vector) -> Vector:
        return self._loops.multiply(vector)

    def begin(self) -> None:
        self.matrix.set_to_mass()

    def solve(self, terms: Terms, right: Vector) -> Vector:
        for place, own in terms.items():
            self.matrix.add(*place, total(own))
        return self.matrix.solved(right)


def added(entries: Entries, terms: Terms) -> Entries:
    """The entries plus terms of them, and of others where rows bind branches of the tree together."""
    places = dict.fromkeys([*entries, *terms])
    return {place: total([entries.get(place, 0.0), *terms.get(place, [])]) for place in places}
