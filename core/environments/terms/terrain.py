"""Uneven ground of boxes: what a job says of it, its height at a point, and the terms that read that."""

from collections.abc import Iterable
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple, Self

from pydantic import AfterValidator, Field, model_validator

from core.documents import Strict
from core.environments.info import Slice, named
from core.environments.options import NotDescending
from core.environments.terms.inventory import ModelParts
from core.environments.terms.observations import ObservationTerm
from core.environments.terms.term import Array

if TYPE_CHECKING:
    from types import ModuleType

    from core.environments.terms.step import ModelIndex, Step

Kind = Literal[
    "flat",
    "stairs_up",
    "stairs_down",
    "slope_up",
    "slope_down",
    "blocks",
    "stepping_stones",
    "gaps",
    "pits",
]
NUM_LEVELS = 10
# What the names of the boxes begin with, before their number; and how many a terrain of all kinds has.
BOX, MOST_BOXES = "terrain ", 23


def _each_once(kinds: list[Kind]) -> list[Kind]:
    if len(set(kinds)) < len(kinds):
        raise ValueError("names a kind twice")
    return kinds


_Metres = Annotated[float, Field(ge=0.0, le=1.0)]
_Span = Annotated[tuple[_Metres, _Metres], Field(strict=False), NotDescending]
_Degrees = Annotated[float, Field(ge=0.0, le=40.0)]
_Angles = Annotated[tuple[_Degrees, _Degrees], Field(strict=False), NotDescending]
_Level = Annotated[int, Field(ge=0, lt=NUM_LEVELS)]


class Terrain(Strict):
    """Uneven ground about each environment's start, in ten levels of difficulty.

    Each pair says [easiest, hardest]: what level 0 has, and what level 9 has.
    """

    kinds: Annotated[list[Kind], Field(min_length=1, max_length=9), AfterValidator(_each_once)] = Field(
        default=["flat", "stairs_up", "stairs_down", "slope_up", "slope_down", "blocks"],
        description="Kinds of ground; environments have all of them in equal shares.",
    )
    levels: Annotated[tuple[_Level, _Level], Field(strict=False), NotDescending] = Field(
        default=(0, NUM_LEVELS - 1), description="[lowest, highest] level, from 0 to 9."
    )
    curriculum: bool = Field(
        default=True,
        description="Whether an environment goes up a level where it walked off the terrain, and down where "
        "it fell or went less than half as far as its commands asked. false: levels are drawn at random.",
    )
    stair_height: _Span = Field(default=(0.02, 0.15), description="Of each of five steps, in m.")
    slope: _Angles = Field(default=(2.0, 20.0), description="In degrees.")
    block_height: _Span = Field(default=(0.02, 0.15), description="The highest block, in m.")
    stone_gap: _Span = Field(default=(0.03, 0.2), description="Between stones, in m.")
    gap: _Span = Field(default=(0.05, 0.4), description="The width of each of two gaps, in m.")
    pit_depth: _Span = Field(default=(0.03, 0.3), description="In m; the robot starts at the bottom.")

    @property
    def num_levels(self) -> int:
        return self.levels[1] - self.levels[0] + 1

    @property
    def has_curriculum(self) -> bool:
        return self.curriculum and self.num_levels > 1


class Ground(NamedTuple):
    """The ground of one environment.

    tops: [surfaces, 6], of each surface the x and y of its middle, half its lengths along x and y, the height
    of its middle and its rise along x, in m. lowest: of the ground that is no hole, [] in m.
    """

    tops: Array
    lowest: Array

    def height(self, points: Array, xp: "ModuleType") -> Array:
        """The height of the ground at points [..., 2], [...] in m."""
        away = points[..., None, :] - self.tops[:, 0:2]
        is_above = xp.all(abs(away) <= self.tops[:, 2:4], axis=-1)
        return xp.max(xp.where(is_above, self.tops[:, 4] + self.tops[:, 5] * away[..., 0], -xp.inf), axis=-1)


def ground_height(step: "Step", points: Array) -> Array:
    """The height of the ground at points [..., 2] of the world's x and y, [...] in m; 0 without terrain."""
    if step.ground is None:
        return step.xp.zeros(points.shape[:-1])
    return step.ground.height(points, step.xp)


class HeightScan(ObservationTerm):
    """z − h − z*: how far the ground is below the root at points about it, less the root's height in the
    pose, in m. The points turn with the root's yaw.

    Source: `height_scan` of Isaac Lab and `measure_heights` of legged_gym (Rudin et al., 2022).
    """

    needs = frozenset({"free_root"})

    kind: Literal["height_scan"] = "height_scan"
    length: float = Field(default=1.2, ge=0, le=10, description="From the rearmost to the foremost point, m.")
    width: float = Field(default=0.8, ge=0, le=10, description="From the rightmost to the leftmost, m.")
    spacing: float = Field(default=0.2, ge=0.02, le=10, description="Between neighbours, m.")
    clip: float | None = Field(default=1.0, gt=0, le=1e6, description="Bounds what is seen to ± this.")

    @model_validator(mode="after")
    def _has_few_points(self) -> Self:
        if (number := len(self.points)) > _MOST_POINTS:
            raise ValueError(f"it has {number:,} points; at most {_MOST_POINTS:,} are allowed")
        return self

    @property
    def points(self) -> list[tuple[float, float]]:
        """Forward and left of the root in m: row by row from behind, each from the right."""
        along, across = (
            [self.spacing * (number - (count - 1) / 2) for number in range(count)]
            for count in (1 + int(size / self.spacing + 1e-6) for size in (self.length, self.width))
        )
        return [(x, y) for x in along for y in across]

    def size(self, parts: ModelParts) -> int:
        return len(self.points)

    def slices(self, parts: ModelParts) -> Iterable[Slice]:
        places = (f"{x:+.2f} {y:+.2f}" for x, y in self.points)
        yield named(
            "height_scan", places, "m", *((None, None) if self.clip is None else (-self.clip, self.clip))
        )

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        start = model.root_position
        root = step.after.qpos[start : start + 7]
        forward = _heading(root[3:], step)
        left = step.xp.stack([-forward[1], forward[0]])
        points = step.xp.asarray(self.points, step.xp.float32)
        ground = ground_height(step, root[:2] + points[:, :1] * forward + points[:, 1:] * left)
        return root[2] - ground - model.pose[start + 2]


def _heading(quaternion: Array, step: "Step") -> Array:
    """The direction of the body's x axis on the ground, [2] of length 1."""
    w, x, y, z = quaternion
    forward = step.xp.stack([w * w + x * x - y * y - z * z, 2.0 * (x * y + w * z)])
    return forward / step.xp.maximum(step.xp.linalg.norm(forward), 1e-6)


# More would take longer than the physics.
_MOST_POINTS = 400
