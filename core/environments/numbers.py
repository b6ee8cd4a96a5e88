"""Where the numbers of an observation are in MuJoCo's own arrays. The API reads it: no numerical code is
imported here."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

# The action before this observation; zeros at the start of an episode.
PREVIOUS_ACTION = "previous_action"


@dataclass(frozen=True)
class Numbers:
    """Numbers of one array, [n]: x[places] − x[less].

    array: a field of MjData in MuJoCo's order, flattened; or `PREVIOUS_ACTION`.
    """

    array: str
    places: Sequence[int]
    less: Sequence[int] = ()


def numbers(array: str, places: Iterable[int]) -> Numbers:
    """`Numbers` at these places."""
    return Numbers(array, [int(place) for place in places])


def rows(array: str, which: Sequence[int], size: int, columns: Sequence[int] | None = None) -> Numbers:
    """These rows of an array whose rows have `size` numbers, or some columns of each row."""
    chosen = range(size) if columns is None else columns
    return Numbers(array, [int(row) * size + column for row in which for column in chosen])
