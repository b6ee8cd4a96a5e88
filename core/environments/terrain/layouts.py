"""Where a terrain's boxes are: a pure function of the kind of ground, its level and random numbers.

Boxes lie in square rings about a platform at the start, four to a ring. Those across x and those across y are
numbered in turn, from one side to the other: so every fourth box is far from the ones before and after it,
which lets the engine `compiled` take a foot's contact with many of them as one. Slopes are two turned boxes.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import radians, tan

import numpy as np
from numpy.typing import NDArray

from core.environments.terms.terrain import NUM_LEVELS, Kind, Terrain

Floats = NDArray[np.float32]

# In m: half the length of the platform, and how far from the start the terrain ends.
PLATFORM, REACH = 0.75, 3.0
# Of a stair, from one riser to the next; and of a stone between easiest and hardest.
_TREAD, _STONE = 0.3, (0.45, 0.3)
# Of holes; the ground between two gaps; what lies beyond the terrain; below the floor.
_DEPTH, _BETWEEN_GAPS, _FAR, _BELOW = 1.0, 0.8, 50.0, 0.5
_SLAB = 1.0
# Blocks, one to a strip of the ground.
_STRIP, _LEAST_HEIGHT = 0.5, 0.3
_BLOCK_WIDTH, _BLOCK_LENGTH, _FREE = (0.12, 0.24), (0.3, 1.2), 0.55
# Rings that each kind needs.
_RINGS: Mapping[Kind, int] = {
    "flat": 0,
    "stairs_up": 5,
    "stairs_down": 4,
    "slope_up": 1,
    "slope_down": 0,
    "blocks": 5,
    "stepping_stones": 5,
    "gaps": 2,
    "pits": 1,
}
_SLOPES = ("slope_up", "slope_down")
# A box that a layout has no use for is so far below the floor; they differ in place, size and turn.
_HIDDEN, _HIDDEN_TURN = 1000.0, 0.1


def num_rings(terrain: Terrain) -> int:
    return max(_RINGS[kind] for kind in terrain.kinds)


def num_upright(terrain: Terrain) -> int:
    """How many boxes are not turned."""
    return 4 * num_rings(terrain) + any(kind != "flat" for kind in terrain.kinds)


def num_boxes(terrain: Terrain) -> int:
    return num_upright(terrain) + 2 * any(kind in _SLOPES for kind in terrain.kinds)


@dataclass
class Layout:
    """Boxes by number; all lengths in m, above the floor and from the start.

    places, sizes: [boxes, 3], their middles and half their lengths. turns: [boxes], about y, in rad; a
    positive one lowers the side at larger x. used: [boxes]. lowest: of the ground that is no hole.
    """

    places: NDArray[np.float64]
    sizes: NDArray[np.float64]
    turns: NDArray[np.float64]
    used: NDArray[np.bool_]
    lowest: float = 0.0
    num_rings: int = field(default=0)

    @classmethod
    def unused(cls, terrain: Terrain) -> "Layout":
        """All boxes are hidden."""
        number = np.arange(num_boxes(terrain), dtype=float)[:, None]
        turns = np.where(number[:, 0] < num_upright(terrain), 0.0, _HIDDEN_TURN)
        places = number * [10.0, 10.0, -1.0] - [0.0, 0.0, _HIDDEN]
        sizes = 0.1 + 0.001 * number * [1.0, 2.0, 3.0]
        return cls(places, sizes, turns, np.zeros(len(number), bool), num_rings=num_rings(terrain))

    def tops(self) -> NDArray[np.float64]:
        """[boxes + 1, 6], as `Ground` has them; the last is the floor. Of hidden boxes the lengths are -1."""
        rows = np.zeros((len(self.places) + 1, 6))
        sine, cosine = np.sin(self.turns), np.cos(self.turns)
        rows[:-1, 0] = self.places[:, 0] + self.sizes[:, 2] * sine
        rows[:-1, 1] = self.places[:, 1]
        rows[:-1, 2] = np.where(self.used, self.sizes[:, 0] * cosine, -1.0)
        rows[:-1, 3] = np.where(self.used, self.sizes[:, 1], -1.0)
        rows[:-1, 4] = self.places[:, 2] + self.sizes[:, 2] * cosine
        rows[:-1, 5] = -np.tan(self.turns)
        rows[-1, 2:4] = np.inf
        return rows

    def quaternions(self) -> NDArray[np.float64]:
        """[boxes, 4]"""
        zero = np.zeros(len(self.turns))
        return np.stack([np.cos(self.turns / 2), zero, np.sin(self.turns / 2), zero], axis=1)

    def put(self, number: int, x: tuple[float, float], y: tuple[float, float], top: float) -> None:
        """An upright box from below the floor to `top`. x, y: where it begins and ends."""
        self.places[number] = [sum(x) / 2, sum(y) / 2, (top - _BELOW) / 2]
        self.sizes[number] = [(x[1] - x[0]) / 2, (y[1] - y[0]) / 2, (top + _BELOW) / 2]
        self.used[number] = True

    def platform(self, top: float, half_width: float = PLATFORM) -> None:
        self.put(4 * self.num_rings // 2, (-PLATFORM, PLATFORM), (-half_width, half_width), top)

    def across_x(self, ring: int, side: int) -> int:
        """The number of a ring's box at larger (1) or smaller (-1) x."""
        return 2 * (self.num_rings + side * ring)

    def across_y(self, ring: int, side: int) -> int:
        return 2 * (self.num_rings + side * ring - (side > 0)) + 1

    def ring(self, number: int, inner: float, outer: float, top: float) -> None:
        """Four boxes about a square. inner, outer: half the lengths of its sides."""
        for side in (-1, 1):
            begin, end = sorted((side * inner, side * outer))
            self.put(self.across_x(number, side), (begin, end), (-outer, outer), top)
            self.put(self.across_y(number, side), (-inner, inner), (begin, end), top)

    def slope(self, side: int, low: tuple[float, float], high: tuple[float, float]) -> None:
        """One of the two slopes. side: 1 at larger x, -1 at smaller. low, high: [|x|, height] of its ends."""
        number = len(self.places) - (2 if side < 0 else 1)
        run, rise = high[0] - low[0], high[1] - low[1]
        angle = -side * np.arctan2(rise, abs(run)) * np.sign(run)
        middle = np.array([side * (low[0] + high[0]) / 2, 0.0, (low[1] + high[1]) / 2])
        normal = np.array([np.sin(angle), 0.0, np.cos(angle)])
        self.places[number] = middle - _SLAB / 2 * normal
        self.sizes[number] = [abs(run) / np.cos(angle) / 2, _FAR, _SLAB / 2]
        self.turns[number], self.used[number] = angle, True


_Draw = Callable[[Layout, Terrain, float, np.random.Generator], None]


def layout(terrain: Terrain, kind: Kind, level: int, variant: int) -> Layout:
    """The boxes of one kind of ground. variant: of those that are drawn at random."""
    drawn = Layout.unused(terrain)
    random = np.random.default_rng([list(_RINGS).index(kind), level, variant])
    _DRAWN[kind](drawn, terrain, level / (NUM_LEVELS - 1), random)
    return drawn


def _at(bounds: tuple[float, float], difficulty: float) -> float:
    return bounds[0] + (bounds[1] - bounds[0]) * difficulty


def _flat(boxes: Layout, terrain: Terrain, difficulty: float, random: np.random.Generator) -> None:
    pass


def _stairs_up(boxes: Layout, terrain: Terrain, difficulty: float, random: np.random.Generator) -> None:
    height, last = _at(terrain.stair_height, difficulty), _RINGS["stairs_up"]
    for ring in range(1, last + 1):
        inner = PLATFORM + (ring - 1) * _TREAD
        boxes.ring(ring, inner, _FAR if ring == last else inner + _TREAD, ring * height)


def _stairs_down(boxes: Layout, terrain: Terrain, difficulty: float, random: np.random.Generator) -> None:
    height, last = _at(terrain.stair_height, difficulty), _RINGS["stairs_down"]
    boxes.platform((last + 1) * height)
    for ring in range(1, last + 1):
        inner = PLATFORM + (ring - 1) * _TREAD
        boxes.ring(ring, inner, inner + _TREAD, (last + 1 - ring) * height)


def _slope_up(boxes: Layout, terrain: Terrain, difficulty: float, random: np.random.Generator) -> None:
    height = (REACH - PLATFORM) * tan(radians(_at(terrain.slope, difficulty)))
    for side in (-1, 1):
        begin, end = sorted((side * REACH, side * _FAR))
        boxes.put(boxes.across_x(1, side), (begin, end), (-_FAR, _FAR), height)
        boxes.slope(side, low=(PLATFORM, 0.0), high=(REACH, height))


def _slope_down(boxes: Layout, terrain: Terrain, difficulty: float, random: np.random.Generator) -> None:
    height = (REACH - PLATFORM) * tan(radians(_at(terrain.slope, difficulty)))
    boxes.platform(height, half_width=_FAR)
    for side in (-1, 1):
        boxes.slope(side, low=(REACH, 0.0), high=(PLATFORM, height))


def _blocks(boxes: Layout, terrain: Terrain, difficulty: float, random: np.random.Generator) -> None:
    highest = _at(terrain.block_height, difficulty)
    for ring in range(_RINGS["blocks"] + 1):
        for side in (-1, 1) if ring else (1,):
            across = side * ring * _STRIP
            boxes.put(boxes.across_x(ring, side), *_block(across, random), _height(highest, random))
            if ring:
                along, over = _block(across, random)
                boxes.put(boxes.across_y(ring, side), over, along, _height(highest, random))


def _height(highest: float, random: np.random.Generator) -> float:
    return highest * random.uniform(_LEAST_HEIGHT, 1.0)


def _block(across: float, random: np.random.Generator) -> tuple[tuple[float, float], tuple[float, float]]:
    """Where a block begins and ends, in the direction in which strips follow each other, and along its own
    strip; not where the robot starts. across: the middle of the strip."""
    half = random.uniform(*_BLOCK_WIDTH)
    length = random.uniform(*_BLOCK_LENGTH)
    middle = random.uniform(-REACH + length, REACH - length)
    if abs(across) - half < _FREE:
        middle = np.copysign(max(abs(middle), _FREE + length), middle)
    return (across - half, across + half), (float(middle - length), float(middle + length))


def _stepping_stones(boxes: Layout, terrain: Terrain, difficulty: float, random: np.random.Generator) -> None:
    gap, last = _at(terrain.stone_gap, difficulty), _RINGS["stepping_stones"]
    stone = _at(_STONE, difficulty)
    _holes(boxes, [gap] * last, [stone] * (last - 1))


def _gaps(boxes: Layout, terrain: Terrain, difficulty: float, random: np.random.Generator) -> None:
    gap = _at(terrain.gap, difficulty)
    _holes(boxes, [gap, gap], [_BETWEEN_GAPS])


def _holes(boxes: Layout, gaps: list[float], rings: list[float]) -> None:
    """A platform, and rings with holes between them. gaps, rings: their widths from within; the last ring has
    no end."""
    boxes.lowest = _DEPTH
    boxes.platform(_DEPTH)
    end = PLATFORM
    for number, (gap, width) in enumerate(zip(gaps, [*rings, _FAR], strict=True), start=1):
        begin, end = end + gap, end + gap + width
        boxes.ring(number, begin, end, _DEPTH)


def _pits(boxes: Layout, terrain: Terrain, difficulty: float, random: np.random.Generator) -> None:
    boxes.ring(1, PLATFORM, _FAR, _at(terrain.pit_depth, difficulty))


_DRAWN: Mapping[Kind, _Draw] = {
    "flat": _flat,
    "stairs_up": _stairs_up,
    "stairs_down": _stairs_down,
    "slope_up": _slope_up,
    "slope_down": _slope_down,
    "blocks": _blocks,
    "stepping_stones": _stepping_stones,
    "gaps": _gaps,
    "pits": _pits,
}

NUM_VARIANTS = 8


@dataclass(frozen=True)
class Layouts:
    """All layouts of a terrain: first axis kinds × levels × variants, in this order.

    places, sizes, quaternions: [.., boxes, n]. tops, lowest: as `Ground` has them. lift: [..], the height of
    the ground at the start, in m.
    """

    places: Floats
    sizes: Floats
    quaternions: Floats
    tops: Floats
    lowest: Floats
    lift: Floats


def draw_layouts(terrain: Terrain) -> Layouts:
    """Every kind at every level that the terrain has, in several variants."""
    low, high = terrain.levels
    every = [
        layout(terrain, kind, level, variant)
        for kind in terrain.kinds
        for level in range(low, high + 1)
        for variant in range(NUM_VARIANTS)
    ]
    places, sizes, quaternions, tops = (
        np.stack(rows)
        for rows in zip(*((o.places, o.sizes, o.quaternions(), o.tops()) for o in every), strict=True)
    )
    return Layouts(
        places=places.astype(np.float32),
        sizes=sizes.astype(np.float32),
        quaternions=quaternions.astype(np.float32),
        tops=tops.astype(np.float32),
        lowest=np.array([one.lowest for one in every], np.float32),
        lift=_heights_at_the_start(tops).astype(np.float32),
    )


def _heights_at_the_start(tops: NDArray[np.float64]) -> NDArray[np.float64]:
    """[..], of the ground where the robot starts."""
    is_above = (np.abs(tops[..., :2]) <= tops[..., 2:4]).all(axis=-1)
    return np.where(is_above, tops[..., 4] - tops[..., 5] * tops[..., 0], -np.inf).max(axis=-1)
