"""Where the numbers of an observation, and what ends an episode, are in MuJoCo's own arrays.

Programs that step a body by MuJoCo alone read them (`core.environments.simulation`); so do terms, and the API
knows their classes: no numerical code is imported here.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

# The reader computes it, [nbody, 6]: of each body, the velocity [3] of its own centre of mass times its share
# of all masses, and its angular velocity [3].
SHARE_VELOCITY = "share_velocity"
# The action before this observation; zeros at the start of an episode.
PREVIOUS_ACTION = "previous_action"
# The next obstacles of a corridor, [3 NUM_AHEAD], in m. Each has three numbers: the distance in x from the
# body to its beginning, the distance to its end, and the distance to the left to the way past it. The body's
# x and y are the first two of `qpos`.
OBSTACLES_AHEAD = "obstacles_ahead"
NUM_AHEAD = 10


class NotSimulated(Exception):
    """The body cannot be stepped by its data alone. The sentence says why."""


@dataclass(frozen=True)
class Numbers:
    """Numbers of one array, [n]: x[places] − x[less] + add, each bounded to ± max_abs.

    array: a field of MjData in MuJoCo's order, flattened; or `SHARE_VELOCITY`, `PREVIOUS_ACTION` or
    `OBSTACLES_AHEAD`.
    """

    array: str
    places: Sequence[int]
    less: Sequence[int] = ()
    add: float = 0.0
    max_abs: float | None = None


@dataclass(frozen=True)
class Ends:
    """The episode ends when one of the numbers leaves [low, high]; None: no bound."""

    numbers: Numbers
    low: float | None
    high: float | None


@dataclass(frozen=True)
class Noise:
    """On an episode's start: uniform in ± position; uniform in ± velocity, or normal with that deviation."""

    position: float
    velocity: float
    is_normal: bool


def numbers(array: str, places: Iterable[int], **changes: Any) -> Numbers:
    """`Numbers` at these places."""
    return Numbers(array, [int(place) for place in places], **changes)


def rows(
    array: str, which: Sequence[int] | range, size: int, columns: Sequence[int] | None = None
) -> Numbers:
    """These rows of an array whose rows have `size` numbers, or some columns of each row."""
    chosen = range(size) if columns is None else columns
    return Numbers(array, [int(row) * size + column for row in which for column in chosen])
