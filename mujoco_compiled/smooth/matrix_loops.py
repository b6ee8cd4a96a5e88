"""Symmetric matrices in memory, and linear equations with them in loops, for bodies with contacts in slots.

A row holds a degree of freedom's entries with those before it: with all of them, or with its ancestors
alone, which are all that a tree needs. It ends with the diagonal and is filled up to blocks of four; what
lies behind its end changes, and is never used.
Source: Featherstone (2008), section 6.5.
"""

from mujoco_compiled.program.arithmetic import Number, Vector, dot, subtract
from mujoco_compiled.program.memory import Array, array, for_each, integers
from mujoco_compiled.program.program import Place
from mujoco_compiled.smooth.factor import factorize, solve
from mujoco_compiled.smooth.tree_loops import TreeLoops

_BLOCK = 4
# Up to here it is faster to write the factor out, and takes no more than 2,000 operations.
_FEW_DOFS = 20


class MatrixLoops:
    """A matrix: first M and what is added, and then its factor. is_dense: whether rows hold all entries."""

    def __init__(self, loops: TreeLoops, *, is_dense: bool) -> None:
        program, tree = loops.program, loops.tree
        self._program, self._loops, self._tree, self._size = program, loops, tree, len(tree.dofs)
        rows = [list(range(i + 1)) if is_dense else [*dof.ancestors, i] for i, dof in enumerate(tree.dofs)]
        blocks = [-(-len(row) // _BLOCK) for row in rows]
        begins = [sum(blocks[:i]) for i in range(self._size)]
        links = [j for row in rows for j in row]
        of_links = [sum(map(len, rows[:i])) for i in range(self._size)]
        self._places = {
            (i, j): _BLOCK * begins[i] + place for i, row in enumerate(rows) for place, j in enumerate(row)
        }
        self._blocks = array(program, "matrix", sum(blocks), _BLOCK)
        self._entries = Array(program, self._blocks.first, 1)
        self._inverses = array(program, "inverse diagonal", self._size)
        self._vector = array(program, "right side", self._size)
        self._begins = integers(program, "matrix rows' begins", begins)
        self._num_blocks = integers(program, "matrix rows' blocks", blocks)
        self._lengths = integers(program, "matrix rows' lengths", [len(row) - 1 for row in rows])
        self._links = integers(program, "matrix links", links)
        self._first_links = integers(program, "matrix rows' links", of_links)
        self._of_mass = integers(
            program, "mass entries' places", [self._places[place] for place in tree.entries]
        )

    def set_to_mass(self) -> None:
        def clear(block: Place, _: Vector) -> Vector:
            self._blocks.store(block, [0.0] * _BLOCK)
            return []

        def copy(entry: Place, _: Vector) -> Vector:
            self._entries.store(self._of_mass.at(entry), self._loops.mass.row(entry))
            return []

        for_each(self._program, self._num_all_blocks, clear)
        for_each(self._program, len(self._tree.entries), copy)

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
        if self._size <= _FEW_DOFS:
            entries = {place: self._entries.row(at)[0] for place, at in self._places.items()}
            return solve(self._tree, factorize(self._tree, entries), right)
        self._factorize()
        return self._solve(right)

    def _factorize(self) -> None:
        """Eliminates from the leaves to the root."""

        def eliminate(before: Place, _: Vector) -> Vector:
            k = before * -1 + (self._size - 1)
            begin, length = self._begins.at(k), self._lengths.at(k)
            inverse = 1.0 / self._entries.row(begin * _BLOCK + length)[0]
            self._inverses.store(k, [inverse])
            first = self._first_links.at(k)

            def update(place: Place, _: Vector) -> Vector:
                i = self._links.at(first + place)
                factor = self._entries.row(begin * _BLOCK + place)[0] * inverse
                of_i = self._begins.at(i)

                def block(number: Place, _: Vector) -> Vector:
                    own, other = self._blocks.row(of_i + number), self._blocks.row(begin + number)
                    self._blocks.store(of_i + number, subtract(own, [factor * x for x in other]))
                    return []

                return for_each(self._program, self._num_blocks.at(i), block)

            return for_each(self._program, length, update)

        for_each(self._program, self._size, eliminate)

    def _solve(self, right: Vector) -> Vector:
        """x [nv] with the factorized matrix times x = right."""
        for i, number in enumerate(right):
            self._vector.store(i, [number])

        def down(before: Place, _: Vector) -> Vector:
            k = before * -1 + (self._size - 1)
            begin, first = self._begins.at(k) * _BLOCK, self._first_links.at(k)
            own = self._inverses.row(k)[0] * self._vector.row(k)[0]
            self._vector.store(k, [own])

            def term(place: Place, _: Vector) -> Vector:
                self._vector.add(
                    self._links.at(first + place), [-(self._entries.row(begin + place)[0] * own)]
                )
                return []

            return for_each(self._program, self._lengths.at(k), term)

        def up(k: Place, _: Vector) -> Vector:
            begin, first = self._begins.at(k) * _BLOCK, self._first_links.at(k)

            def term(place: Place, now: Vector) -> Vector:
                known = self._vector.row(self._links.at(first + place))
                return [now[0] + dot(self._entries.row(begin + place), known)]

            (found,) = for_each(self._program, self._lengths.at(k), term, [0.0])
            self._vector.add(k, [-(self._inverses.row(k)[0] * found)])
            return []

        for_each(self._program, self._size, down)
        for_each(self._program, self._size, up)
        return [self._vector.row(i)[0] for i in range(self._size)]

    @property
    def _num_all_blocks(self) -> int:
        return sum(self._num_blocks.values)
