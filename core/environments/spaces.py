"""The numbers of an observation and of an action by name; the API reads them, so no NumPy here."""

from collections.abc import Iterable
from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Slice:
    """A part of an observation, or of an action: `size` numbers from `start` on.

    name: the same for neighbouring slices of one array, each of which has one unit. unit: `1` for numbers
    without one; several, in the order of a row, where rows of different quantities repeat; None where it is
    not known. low, high: of an observation bounds that its values keep, up to rounding, or None; of an
    action, whose numbers lie in [-1, 1], what -1 and 1 set. components: a name for each number; empty where
    they are not known.
    """

    name: str
    start: int
    size: int
    unit: str | None = None
    low: float | None = None
    high: float | None = None
    components: tuple[str, ...] = ()


@dataclass(frozen=True)
class Spaces:
    """All slices of an environment's observation and of its action, in their order."""

    observation: tuple[Slice, ...] = ()
    action: tuple[Slice, ...] = ()

    @property
    def observation_size(self) -> int:
        return sum(one.size for one in self.observation)


def named(
    name: str,
    components: Iterable[str],
    unit: str | None,
    low: float | None = None,
    high: float | None = None,
) -> Slice:
    """A slice whose place is not yet known."""
    names = tuple(components)
    return Slice(name, 0, len(names), unit, low, high, names)


def in_order(slices: Iterable[Slice]) -> tuple[Slice, ...]:
    """The slices one after the other; empty ones are left out."""
    placed: list[Slice] = []
    start = 0
    for one in slices:
        if one.size:
            placed.append(replace(one, start=start))
            start += one.size
    return tuple(placed)
