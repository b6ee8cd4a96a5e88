"""A curve as one line of characters."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

_BARS = "▁▂▃▄▅▆▇█"
WIDTH = 24


@dataclass
class History:
    """One metric over rising steps."""

    steps: list[int] = field(default_factory=list[int])
    values: list[float] = field(default_factory=list[float])

    def add(self, step: int, value: float | None) -> None:
        """Append a value. One of an earlier step comes from an attempt that began again at a checkpoint: it
        replaces what followed that checkpoint. None, a value that was not finite, is left out."""
        if value is None:
            return
        while self.steps and self.steps[-1] >= step:
            self.steps.pop()
            self.values.pop()
        self.steps.append(step)
        self.values.append(value)


def sparkline(values: Sequence[float], width: int = WIDTH) -> str:
    """One character for each value, from the least (▁) to the greatest (█); of more than `width` values one
    for each of `width` equally long parts, by its mean."""
    if len(values) > width:
        edges = [part * len(values) // width for part in range(width + 1)]
        parts = [values[start:end] for start, end in pairwise(edges)]
        values = [sum(part) / len(part) for part in parts]
    if not values:
        return ""
    low, span = min(values), max(values) - min(values)
    places = [round((value - low) / span * (len(_BARS) - 1)) if span else 3 for value in values]
    return "".join(_BARS[place] for place in places)
