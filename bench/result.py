"""A measurement's outcome as a value: what its table shows and its JSON file holds."""

from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict

from bench.machine import Machine
from bench.statistics import Spread


class _Document(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Target(_Document):
    """What a figure has to reach."""

    comparison: Literal["at least", "at most", "below"]
    value: float

    def is_met(self, value: float) -> bool:
        match self.comparison:
            case "at least":
                return value >= self.value
            case "at most":
                return value <= self.value
            case "below":
                return value < self.value


class Figure(_Document):
    """One number. low, high: of the rounds it is the median of, if there were several."""

    name: str
    value: float
    unit: str
    low: float | None = None
    high: float | None = None
    target: Target | None = None

    @property
    def met(self) -> bool | None:
        """Whether it reaches its target; None where it has none."""
        return None if self.target is None else self.target.is_met(self.value)

    @classmethod
    def of(cls, name: str, rounds: Spread, unit: str, target: Target | None = None) -> "Figure":
        """The median of some rounds, with its least and its greatest."""
        return cls(name=name, value=rounds.median, unit=unit, low=rounds.low, high=rounds.high, target=target)


class Result(_Document):
    """One bench's outcome. rows: every single measurement; notes: what a reader must know to believe it.

    quick: made by a smoke test of the bench itself; its numbers say nothing.
    """

    name: str
    title: str
    command: str
    quick: bool
    machine: Machine
    figures: list[Figure]
    rows: list[dict[str, str | int | float | bool | None]]
    notes: list[str] = []

    def save(self, folder: Path) -> Path:
        """Write `<name>.json`; its path."""
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f"{self.name}.json"
        path.write_text(self.model_dump_json(indent=2) + "\n")
        return path


class Options(_Document):
    """What a bench is told. quick: the smallest run that shows that the bench itself works."""

    quick: bool = False
    fresh_clone: bool = False


def at_least(value: float) -> Target:
    return Target(comparison="at least", value=value)


def at_most(value: float) -> Target:
    return Target(comparison="at most", value=value)


def below(value: float) -> Target:
    return Target(comparison="below", value=value)
