"""A measurement's outcome as a value, which its table, its pictures and its JSON file show."""

from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from bench.measure.machine import Machine
from bench.measure.statistics import Estimate, Spread


class _Document(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Target(_Document):
    """The value that a figure has to reach."""

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
    """One number, or why there is none.

    low, high: the range of the rounds whose median it is, if there were several. error: the standard error of
    a mean over seeds. missing: why the measurement failed; its target then counts as missed.
    """

    name: str
    value: float | None
    unit: str
    low: float | None = None
    high: float | None = None
    error: float | None = None
    target: Target | None = None
    missing: str | None = None

    @property
    def met(self) -> bool | None:
        """Whether it reaches its target; None if it has none."""
        if self.target is None:
            return None
        return self.value is not None and self.target.is_met(self.value)

    @classmethod
    def of(cls, name: str, rounds: Spread, unit: str, target: Target | None = None) -> "Figure":
        """The median of some rounds, with their minimum and maximum."""
        return cls(name=name, value=rounds.median, unit=unit, low=rounds.low, high=rounds.high, target=target)

    @classmethod
    def of_mean(cls, name: str, seeds: Estimate, unit: str) -> "Figure":
        """The mean over seeds, with its standard error if there are several."""
        return cls(name=name, value=seeds.mean, unit=unit, error=seeds.error)


class Table(_Document):
    """A table that a result shows besides its figures; its texts are Markdown."""

    headings: list[str]
    rows: list[list[str]]


class Line(_Document):
    """One curve; those with equal labels share a colour and one entry in the legend."""

    label: str
    points: list[tuple[float, float]]


class Panel(_Document):
    """Curves over common axes."""

    kind: Literal["curves"] = "curves"
    title: str
    x: str
    y: str
    lines: list[Line]


class Bars(_Document):
    """One bar per group and series; None if it was not measured. stacked: the series on top of each other."""

    kind: Literal["bars"] = "bars"
    title: str
    unit: str
    groups: list[str]
    series: dict[str, list[float | None]]
    stacked: bool = False


class Picture(_Document):
    """A picture that `report` draws to docs/pictures/bench-<name>.png, its panels side by side."""

    name: str
    caption: str
    panels: list[Panel | Bars] = Field(min_length=1)


class Result(_Document):
    """One bench's outcome. rows: every single measurement; notes: what a reader must know to judge it.

    quick: made by a smoke test of the bench itself; its numbers mean nothing. unfinished: the runs for which
    there was no time.
    """

    name: str
    title: str
    command: str
    quick: bool
    machine: Machine
    figures: list[Figure]
    rows: list[dict[str, str | int | float | bool | None]]
    notes: list[str] = []
    table: Table | None = None
    pictures: list[Picture] = []
    unfinished: list[str] = []

    def save(self, folder: Path) -> Path:
        """Write `<name>.json`; returns its path."""
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f"{self.name}.json"
        path.write_text(self.model_dump_json(indent=2) + "\n")
        return path


class Options(_Document):
    """The options of a bench.

    quick: the smallest run that shows that the bench itself works. out: where results go; the runs a bench
    is made of are kept in `runs/` there. resume: keep the runs that exist. seconds: the time for this call,
    which starts no run that would take longer. only: a pattern; of the missing runs, make those whose name
    matches. seeds: how many; None: the bench's own number. first: the first seed of the campaign. worlds: how
    many of the campaign's run side by side; None: one for every two cores. minutes: how long the bench lasts;
    None: its own time. gpu: measure the first GPU. kinds: of the campaign's faults; each draws all seeds.
    """

    quick: bool = False
    fresh_clone: bool = False
    out: Path = Path("bench-results")
    resume: bool = False
    seconds: float | None = None
    only: str = "*"
    seeds: int | None = None
    minutes: float | None = None
    gpu: bool = False
    first: int = 0
    worlds: int | None = None
    kinds: tuple[str, ...] = ("faults",)


def at_least(value: float) -> Target:
    return Target(comparison="at least", value=value)


def at_most(value: float) -> Target:
    return Target(comparison="at most", value=value)


def below(value: float) -> Target:
    return Target(comparison="below", value=value)
