"""Symmetric matrices in memory, and linear equations with them in loops, for bodies with contacts in slots.

A row holds a degree of freedom's entries with those before it: with all of them, or with its ancestors
alone, which are all that a tree needs. It ends with the diagonal and is filled up to blocks of four; what
lies behind its end changes, and is never used.
Source: Featherstone (2008), section 6.5.
"""

from functools import partial

from mujoco_compiled.program.arithmetic import Number, Vector, subtract
from mujoco_compiled.program.memory import Array, Table, array, for_each, integers
from mujoco_compiled.program.program import Place
from mujoco_compiled.smooth.factor import factorize, solve
from mujoco_compiled.smooth.tree_loops import FEW_DOFS, TreeLoops

_BLOCK = 4


class MatrixLoops:
    """A matrix: first M and what is added, and then its factor. is_dense: whether rows hold all entries."""

    def __init__(self, loops: TreeLoops, *, is_dense: bool) -> None:
        program, tree = loops.program, loops.tree
        self._program, self._loops, self._tree, self._size = program, loops, tree, len(tree.dofs)
        rows = [list(range(i + 1)) if is_dense else [*dof.ancestors, i] for i, dof in enumerate(tree.dofs)]
        num_blocks = [-(-len(row) // _BLOCK) for row in rows]
        begins = [sum(num_blocks[:i]) for i in range(self._size)]
        self._num_all_blocks = sum(num_blocks)
        self._places = {
            (i, j): _BLOCK * begins[i] + place for i, row in enumerate(rows) for place, j in enumerate(row)
        }
        # A routine solves: the threads that share it see what it works on.
        made = partial(array, space="shared" if program.has_team and self._size > FEW_DOFS else "numbers")
        self._blocks = made(program, "matrix", sum(num_blocks), _BLOCK)
        self._entries = self._blocks.flat()
        self._right = made(program, "right side", self._size)
        self._solution = made(program, "solution", self._size)
        self._begins = integers(program, "matrix rows' begins", begins)
        self._of_mass = integers(
            program, "mass entries' places", [self._places[place] for place in tree.entries]
        )
        if self._size <= FEW_DOFS:
            return
        self._inverses = made(program, "inverse diagonal", self._size)
        self._diagonal = integers(program, "diagonal", [self._places[k, k] for k in range(self._size)])
        # By row k: those above that its elimination changes, with begin and length in blocks, and where row k
        # has its entry with them.
        self._changed = Table(
            program,
            "changed rows",
            [
                [(i, begins[i], num_blocks[i], self._places[k, i]) for i in rows[k][:-1]]
                for k in range(self._size)
            ],
        )
        self._below = Table(
            program,
            "entries below",
            [
                [(i, self._places[i, j]) for i in range(j + 1, self._size) if (i, j) in self._places]
                for j in range(self._size)
            ],
        )

    def set_to_mass(self) -> None:
        def set_all() -> None:
            self._clear()
            self._copy()

        self._loops.share("set the matrix to mass", set_all)

    def add(self, i: int, j: int, value: Number) -> None:
        """To an entry of the lower triangle."""
        self._entries.add(self._places[i, j], [value])

    def add_at(self, dof: Place, other: Place, value: Number) -> None:
        """To an entry of the lower triangle that the running program chooses; the matrix is dense."""
        self._entries.add(self._begins.at(dof) * _BLOCK + other, [value])

    def add_bends(self, bends: Array) -> None:
        """Aᵀ K A, with the axes A and by row a body's own curvature K [21]; see `body_rows.curvature`."""
        self._loops.add_projected(bends, self._of_mass, self._entries)

    def solved(self, right: Vector) -> Vector:
        """x [nv] with the matrix times x = right."""
        if self._size <= FEW_DOFS:
            entries = {place: self._entries.row(at)[0] for place, at in self._places.items()}
            return solve(self._tree, factorize(self._tree, entries), right)
        for i, number in enumerate(right):
            self._right.store(i, [number])
        self._loops.share("solve", self._solve)
        return [self._solution.row(i)[0] for i in range(self._size)]

    def _solve(self) -> None:
        """Eliminates from the leaves to the root, and finds the solution from the root to the leaves."""
        size = self._size

        def eliminate(before: Place, _: Vector) -> Vector:
            k = before * -1 + (size - 1)
            begin = self._begins.at(k)
            inverse = 1.0 / self._entries.row(self._diagonal.at(k))[0]
            known = inverse * self._right.row(k)[0]
            self._inverses.store(k, [inverse])
            self._solution.store(k, [known])

            def change(row: Place, _: Vector) -> Vector:
                i, first, length, place = self._changed.at(row)
                entry = self._entries.row(place)[0]
                factor = entry * inverse
                self._right.add(i, [-(entry * known)])

                def block(number: Place, _: Vector) -> Vector:
                    own, other = self._blocks.row(first + number), self._blocks.row(begin + number)
                    self._blocks.store(first + number, subtract(own, [factor * x for x in other]))
                    return []

                return for_each(self._program, length, block)

            return self._changed.for_each(k, change, is_parted=True)

        def find(j: Place, _: Vector) -> Vector:
            found = self._solution.row(j)[0]

            def take(row: Place, _: Vector) -> Vector:
                i, place = self._below.at(row)
                factor = self._inverses.row(i)[0] * self._entries.row(place)[0]
                self._solution.add(i, [-(factor * found)])
                return []

            return self._below.for_each(j, take, is_parted=True)

        for_each(self._program, size, eliminate)
        for_each(self._program, size, find)

    def _clear(self) -> None:
        def clear(block: Place, _: Vector) -> Vector:
            self._blocks.store(block, [0.0] * _BLOCK)
            return []

        for_each(self._program, self._num_all_blocks, clear, is_parted=True)

    def _copy(self) -> None:
        def copy(entry: Place, _: Vector) -> Vector:
            self._entries.store(self._of_mass.at(entry), self._loops.mass.row(entry))
            return []

        for_each(self._program, len(self._tree.entries), copy, is_parted=True)
