"""Which of a hull's vertices is farthest in a direction, by a table.

A direction points at a place on a cube's side. Each side is cut into squares, and a table has for each square
the few vertices that are farthest in a direction through it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mujoco_compiled.program.arithmetic import Number, Vector, absolute, clip, dot, maximum, select, truncated
from mujoco_compiled.program.flow import repeat
from mujoco_compiled.program.memory import Lookup

# Squares along an edge of a side: from about this many vertices on, twice as many.
_MANY, _FEW_SQUARES, _MANY_SQUARES = 100, 8, 16
_LOWEST = -1e9
Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Farthest:
    """num_squares: along an edge. vertices: their coordinates. candidates: numbers of vertices, one square
    after the other; ends: by square, where its own begin and end. most: candidates of a square."""

    num_squares: int
    vertices: Sequence[Lookup]
    candidates: Lookup
    ends: tuple[Lookup, Lookup]
    most: int

    def at(self, direction: Vector) -> tuple[Number, Vector]:
        """The number of the vertex that is farthest in a direction [3], and the vertex [3]."""
        square = self._square(direction)
        begin, end = (one.at(square) for one in self.ends)

        def look(carried: list[Number]) -> tuple[list[Number], Number]:
            place, reach, *best = carried
            number = self.candidates.at(place)
            vertex = [one.at(number) for one in self.vertices]
            own = dot(vertex, direction)
            is_farther = reach < own
            found = zip([own, number, *vertex], [reach, *best], strict=True)
            return [place + 1.0, *(select(is_farther, x, y) for x, y in found)], place + 1.0 < end

        none = 0.0 * begin
        number, *vertex = repeat(self.most, look, [begin, none + _LOWEST, *[none] * 4])[2:]
        return number, vertex

    def _square(self, direction: Vector) -> Number:
        """The number of the square at which a direction points."""
        x, y, z = direction
        along_y = absolute(x) < absolute(y)
        along_z = maximum(absolute(x), absolute(y)) < absolute(z)
        largest = select(along_z, z, select(along_y, y, x))
        side = select(along_z, 4.0, select(along_y, 2.0, 0.0)) + select(largest < 0.0, 1.0, 0.0)
        half = 0.5 * self.num_squares
        factor = half / absolute(largest)
        u, v = select(along_z, x, select(along_y, x, y)), select(along_z, y, z)
        row, column = (truncated(clip(w * factor + half, 0.0, self.num_squares - 1.0)) for w in (u, v))
        return (side * self.num_squares + row) * self.num_squares + column


def farthest_of(name: str, vertices: Array) -> Farthest:
    """name: of the vertices [n, 3]."""
    num_squares = _FEW_SQUARES if len(vertices) < _MANY else _MANY_SQUARES
    found = _of_squares(vertices.tobytes(), num_squares)
    ends = np.cumsum([0, *map(len, found)]).astype(float)
    return Farthest(
        num_squares=num_squares,
        vertices=[Lookup(f"{name} vertices {axis}", vertices[:, axis].copy()) for axis in range(3)],
        candidates=Lookup(f"{name} farthest", np.concatenate(found).astype(float)),
        ends=(Lookup(f"{name} squares", ends[:-1]), Lookup(f"{name} squares' ends", ends[1:])),
        most=max(map(len, found)),
    )


@lru_cache(maxsize=64)
def _of_squares(vertices: bytes, num_squares: int) -> list[Array]:
    """By square: the vertices that can be farthest. vertices: of [n, 3]."""
    every = np.frombuffer(vertices).reshape(-1, 3)
    return [square for side in range(6) for square in _of_side(every, side, num_squares)]


def _of_side(vertices: Array, side: int, num_squares: int) -> list[Array]:
    axis, sign = side // 2, 1.0 - 2.0 * (side % 2)
    u, v = (other for other in range(3) if other != axis)
    # A little larger than they are: rounding may find a place in the next square.
    lines = np.linspace(-1.0, 1.0, num_squares + 1)
    more = 1e-5
    found = list[Array]()
    for row in range(num_squares):
        for column in range(num_squares):
            corners = np.zeros((4, 3))
            corners[:, axis] = sign
            corners[:, u] = np.repeat([lines[row] - more, lines[row + 1] + more], 2)
            corners[:, v] = np.tile([lines[column] - more, lines[column + 1] + more], 2)
            found.append(_undominated(corners @ vertices.T))
    return found


def _undominated(reaches: Array) -> Array:
    """The vertices that no other one is beyond in all four corners' directions, and so in all between them.

    reaches: [4, n].
    """
    kept = np.arange(reaches.shape[1])
    # First beside those that are farthest at the corners, which leave few.
    for one in dict.fromkeys(reaches.argmax(axis=1).tolist()):
        kept = kept[~(reaches[:, kept] < reaches[:, one][:, None]).all(axis=0)]
    own = reaches[:, kept]
    beats = (own[:, :, None] > own[:, None, :]).all(axis=0)
    return kept[~beats.any(axis=0)]
