"""The least memory that a run needs, known before it begins; imports no numerical code.

Only what is certainly in memory at the same time is counted: too low an estimate lets a run begin that may
fail later, and too high an estimate would refuse a run that fits.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

FLOAT_BYTES = 4
_UNITS = ("bytes", "KiB", "MiB", "GiB", "TiB", "PiB")


@dataclass(frozen=True)
class MemoryPart:
    """Something in each device's memory. bytes: on one device; lower: the settings that make it smaller."""

    what: str
    bytes: int
    lower: tuple[str, ...]


@dataclass(frozen=True)
class MemoryNeed:
    """The parts of a run."""

    parts: Sequence[MemoryPart]

    @property
    def bytes(self) -> int:
        """The sum over all parts."""
        return sum(part.bytes for part in self.parts)

    @property
    def lower(self) -> tuple[str, ...]:
        """The settings that make the largest part smaller."""
        return max(self.parts, key=lambda part: part.bytes).lower

    def of_seeds(self, num_seeds: int) -> "MemoryNeed":
        """The memory of as many such runs side by side."""
        if num_seeds == 1:
            return self
        fewer = "the number of seeds"
        parts = [
            replace(part, bytes=num_seeds * part.bytes, lower=(*part.lower, fewer)) for part in self.parts
        ]
        return MemoryNeed(parts)

    def does_not_fit(self, limit_bytes: int, where: str) -> str:
        """The error message. where: what has this limit."""
        parts = sorted(self.parts, key=lambda part: -part.bytes)
        named = ", ".join(f"{shown(part.bytes)} for {part.what}" for part in parts if part.bytes)
        *others, last = self.lower
        less = f"{', '.join(others)} or {last}" if others else last
        return (
            f"The run needs at least {shown(self.bytes)} of memory on its device ({named}), but {where} has "
            f"{shown(limit_bytes)}: lower {less}."
        )


def perceptron(sizes: Sequence[int]) -> int:
    """How many weights and biases a multilayer perceptron with layers of these sizes has."""
    return sum(before * after + after for before, after in pairwise(sizes))


def shown(num_bytes: int) -> str:
    """Bytes for people: three digits and a unit."""
    value, unit = float(num_bytes), 0
    while value >= 1024 and unit < len(_UNITS) - 1:
        value, unit = value / 1024, unit + 1
    return f"{value:,.3g} {_UNITS[unit]}" if value < 1000 else f"{value:,.0f} {_UNITS[unit]}"
