"""Where convex geoms touch a height field: at one point of each of the prisms under them, as in MuJoCo.

Which prisms are under a geom is each environment's own, so a loop goes over as many as there can be, and
looks up the heights. A geom's bounds along the field's axes tell which of them may touch.
Source: `mjc_ConvexHField`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, reduce
from itertools import product as pairs_of
from operator import and_

from mujoco_compiled.collisions.convex import convex_touch
from mujoco_compiled.collisions.fields import HeightField
from mujoco_compiled.collisions.shapes import AWAY, Placed, Touch
from mujoco_compiled.collisions.supports import (
    BOX,
    CAPSULE,
    CYLINDER,
    ELLIPSOID,
    MESH,
    SPHERE,
    Convex,
    convex_geom,
    unit_or,
)
from mujoco_compiled.program.arithmetic import (
    Number,
    Vector,
    add,
    clip,
    cross,
    dot,
    maximum,
    product,
    scale,
    select,
    subtract,
    total,
    transpose,
    truncated,
)
from mujoco_compiled.program.memory import column, for_each, rows, where_any
from mujoco_compiled.program.program import Place, Program

# What can touch a height field.
ON_FIELDS = frozenset({SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX, MESH})
_UNTURNED = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
_UP = [0.0, 0.0, 1.0]


def num_field_points(window: tuple[int, int]) -> int:
    """At how many points geoms may touch a field, of environments that each are elsewhere. window: see
    `HeightField`."""
    return 2 * window[0] * window[1]


@dataclass(frozen=True)
class Window:
    """The prisms that can be under the geoms of a loop. name: of the loop. size: see `HeightField.window`."""

    program: Program
    name: str
    size: tuple[int, int]

    def each_touch(
        self, kind: int, field: Placed, geom: Placed, reach: Number, put: Callable[[Touch], None]
    ) -> None:
        """Puts the points, in the world's frame, where a geom of this kind may be within `reach` in m."""
        assert field.field is not None  # noqa: S101
        under = _under(field.field, _seen_from(field, kind, geom), reach)
        number = num_field_points(self.size)
        near = rows(self.program, f"{self.name} prisms", number)

        def look(place: Place, _: Vector) -> Vector:
            where_any(self._prism(under, place).is_near, lambda: near.append(place))
            return []

        def touch(row: Place, _: Vector) -> Vector:
            found = self._prism(under, near.at(row)).touch()
            position = add(field.position, field.outward(found.position))
            put(Touch(position, found.distance, field.outward(found.normal)))
            return []

        near.clear()
        for_each(self.program, number, look)
        for_each(self.program, near.length(), touch)

    def _prism(self, under: "_Under", place: Place) -> "_Prism":
        """The prism at a place: cell by cell, each with the one at its upper left and at its lower right."""
        every = list(pairs_of(range(self.size[1]), range(self.size[0]), (0.0, 1.0)))
        across, along, right = (
            column(self.program, f"{self.size} prisms {k}", [float(x) for x in own]).at(place)
            for k, own in enumerate(zip(*every, strict=True))
        )
        first = under.first_cell
        return _Prism(self.program, under, first[0] + along, first[1] + across, right)


@dataclass(frozen=True)
class _Under:
    """What of a field is under a geom, in the field's frame.

    cells: along x and y, the geom's bounds as places in the grid. first_cell: the first one there. low: lower
    prisms do not touch, in m.
    """

    field: HeightField
    geom: Convex
    cells: list[tuple[Number, Number]]
    first_cell: list[Number]
    low: Number


def _under(field: HeightField, geom: Convex, reach: Number) -> _Under:
    downwards = [[-x for x in axis] for axis in _UNTURNED]
    high_x, high_y, *lows = (
        dot(way, geom.support(way)) + geom.radius + reach for way in (*_UNTURNED[:2], *downwards)
    )
    sides = zip(lows[:2], (high_x, high_y), field.half, field.cell, strict=True)
    cells = [((half - low) * (1.0 / cell), (high + half) * (1.0 / cell)) for low, high, half, cell in sides]
    lasts = field.num_columns - 2, field.num_rows - 2
    firsts = [truncated(clip(low, 0.0, float(last))) for (low, _), last in zip(cells, lasts, strict=True)]
    return _Under(field, geom, cells, firsts, -lows[2])


@dataclass(frozen=True)
class _Prism:
    """Half a cell, in the field's frame.

    along, across: the cell's place in the grid. right: 1 for the half at the lower right of the diagonal from
    (0, 0) to (1, 1), 0 for the other.
    """

    program: Program
    under: _Under
    along: Number
    across: Number
    right: Number

    @cached_property
    def corners(self) -> list[Vector]:
        """Of the top, each [3]: both ends of the diagonal, and the third one."""
        one, other = self.right, 1.0 - self.right
        return [self._corner(*place) for place in ((0.0, 0.0), (1.0, 1.0), (one, other))]

    def _corner(self, x: Number, y: Number) -> Vector:
        field = self.under.field
        heights = column(self.program, f"height field {field.number}", field.heights)
        x, y = self.along + x, self.across + y
        height = heights.looked_up(y * float(field.num_columns) + x, len(field.heights) - 1)
        return [x * field.cell[0] - field.half[0], y * field.cell[1] - field.half[1], height]

    @property
    def is_near(self) -> Number:
        """Whether there is this prism, and under the geom, and as high."""
        field, (along, across) = self.under.field, self.under.cells
        tops = [corner[2] for corner in self.corners]
        return reduce(
            and_,
            (
                self.along < field.num_columns - 1.5,
                self.across < field.num_rows - 1.5,
                self.along < along[1],
                self.across < across[1],
                along[0] < self.along + 1.0,
                across[0] < self.across + 1.0,
                self.under.low < reduce(maximum, tops),
            ),
        )

    def touch(self) -> Touch:
        found = convex_touch(self, self.under.geom)
        return Touch(found.position, select(self.is_near, found.distance, AWAY), found.normal)

    @property
    def position(self) -> Vector:
        """Its middle."""
        x, y, z = (total(values) * (1.0 / 3.0) for values in zip(*self.corners, strict=True))
        return [x, y, 0.5 * (z - self.under.field.base)]

    @property
    def size(self) -> Vector:
        return [*self.under.field.cell, self.under.field.cell[0]]

    @property
    def radius(self) -> Number:
        return 0.0

    def support(self, direction: Vector) -> Vector:
        """See `Body`."""
        is_down = direction[2] < 0.0
        found: tuple[Number, Vector] | None = None
        for x, y, top in self.corners:
            corner = [x, y, select(is_down, -self.under.field.base, top)]
            reach = dot(corner, direction)
            if found is None:
                found = reach, corner
                continue
            is_farther = found[0] < reach
            point = [select(is_farther, one, other) for one, other in zip(corner, found[1], strict=True)]
            found = select(is_farther, reach, found[0]), point
        assert found is not None  # noqa: S101
        return found[1]

    def normals(self, way: Vector) -> list[Vector]:
        """Of the top and the three sides; see `Body`."""
        del way
        sign = 2.0 * self.right - 1.0
        first, second, third = self.corners
        top = scale(cross(subtract(third, first), subtract(second, first)), sign)
        x, y = self.under.field.cell
        length = (x * x + y * y) ** 0.5
        sides = ([1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [-y / length, x / length, 0.0])
        return [unit_or(top, _UP), *(scale(side, sign) for side in sides)]


def _seen_from(field: Placed, kind: int, geom: Placed) -> Convex:
    """A geom in the field's frame."""
    axes, own = (product(one.to_world, one.to_body) for one in (field, geom))
    place = field.inward(subtract(geom.position, field.position))
    return convex_geom(kind, Placed(place, product(transpose(axes), own), _UNTURNED, geom.size, geom.hull))
