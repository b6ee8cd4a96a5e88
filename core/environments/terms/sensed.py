"""What a robot measures for the terms of an observation; no numerical code."""

from collections.abc import Iterable
from dataclasses import dataclass

from core.environments.info import Slice

# The policy's own last action, which no robot measures.
PREVIOUS_ACTION = "previous_action"
# The gait's clock, which no robot measures either.
CLOCK = "clock"


@dataclass(frozen=True)
class Sensed:
    """The numbers of a term are x[places] − less, where x is an array that a robot measures.

    name: of x. components: a name for each number of x. unit: theirs; None where it is not known. places: the
    numbers of the term; None: all. less: [len(places)]; empty: nothing.
    """

    name: str
    components: tuple[str, ...]
    unit: str | None
    places: tuple[int, ...] | None = None
    less: tuple[float, ...] = ()


def as_measured(name: str, slices: Iterable[Slice]) -> Sensed:
    """A term whose numbers a robot measures as they are."""
    parts = list(slices)
    components = [
        component
        for part in parts
        for component in part.components or [f"{part.name} {number}" for number in range(part.size)]
    ]
    units = list(dict.fromkeys(part.unit for part in parts))
    known = None if None in units else ", ".join(filter(None, units))
    return Sensed(name, tuple(components), known)
