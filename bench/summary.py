"""The figures of a bench, as a table on a terminal and as a summary file of at most 100 lines."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

from rich.console import Console
from rich.table import Table

MOST_LINES = 100


@dataclass(frozen=True)
class Figure:
    """One number, or the reason why there is none (`missing`), which counts as a missed target.

    low, high: the range of the rounds whose median it is. at_most, at_least: its target.
    """

    name: str
    value: float | None
    unit: str = ""
    low: float | None = None
    high: float | None = None
    at_most: float | None = None
    at_least: float | None = None
    missing: str = ""

    @property
    def target(self) -> str:
        if self.at_most is not None:
            return f"≤ {number(self.at_most)}"
        return "" if self.at_least is None else f"≥ {number(self.at_least)}"

    @property
    def met(self) -> bool | None:
        """Whether it reaches its target; None if it has none."""
        if not self.target:
            return None
        if self.value is None:
            return False
        return self.value <= self.at_most if self.at_most is not None else self.value >= (self.at_least or 0)

    def document(self) -> dict[str, Any]:
        """Its line of a summary file, without what it lacks."""
        whole = {
            "figure": self.name,
            "value": _rounded(self.value),
            "unit": self.unit or None,
            "range": None if self.low is None else [_rounded(self.low), _rounded(self.high)],
            "target": self.target or None,
            "met": self.met,
            "missing": self.missing or None,
        }
        return {key: value for key, value in whole.items() if value is not None or key == "value"}


def middle(
    name: str,
    rounds: Sequence[float],
    unit: str = "",
    *,
    at_most: float | None = None,
    at_least: float | None = None,
    missing: str = "not measured",
) -> Figure:
    """The median of some rounds with their range; a missing figure if there are none."""
    if not rounds:
        return Figure(name, None, unit, at_most=at_most, at_least=at_least, missing=missing)
    low, high = (min(rounds), max(rounds)) if len(rounds) > 1 else (None, None)
    return Figure(name, median(rounds), unit, low, high, at_most, at_least)


def percentile(values: Sequence[float], percent: float) -> float:
    """The smallest value that at least `percent` % of them do not exceed. Raises ValueError for none."""
    if not values:
        raise ValueError("There is nothing to take a percentile of.")
    return sorted(values)[max(1, math.ceil(percent / 100 * len(values))) - 1]


@dataclass(frozen=True)
class Run:
    """One call of a bench: the figures with what made them. date: of its start, `2026-11-27`."""

    command: str
    date: str
    commit: str
    machine: str
    figures: Sequence[Figure] = field(default_factory=tuple[Figure, ...])

    def document(self) -> dict[str, Any]:
        head = {name: getattr(self, name) for name in ("command", "date", "commit", "machine")}
        return {**head, "figures": [figure.document() for figure in self.figures]}


def save(folder: Path, bench: str, run: Run) -> Path:
    """Put the run into `<bench>.json`, in place of the last one of the same command; returns the path.

    The oldest runs go where the file would be longer than 100 lines.
    """
    path = folder / f"{bench}.json"
    runs = json.loads(path.read_text())["runs"] if path.exists() else []
    runs = [one for one in runs if one["command"] != run.command]
    runs = sorted([*runs, run.document()], key=lambda one: one["date"])
    while len(runs) > 1 and _text(bench, runs).count("\n") > MOST_LINES:
        del runs[0]
    folder.mkdir(parents=True, exist_ok=True)
    path.write_text(_text(bench, runs))
    return path


def _text(bench: str, runs: Sequence[dict[str, Any]]) -> str:
    """JSON with a line for each figure."""
    parts = list[str]()
    for run in runs:
        head = ", ".join(f"{_json(key)}: {_json(value)}" for key, value in run.items() if key != "figures")
        lines = ",\n".join(f"   {_json(figure)}" for figure in run["figures"])
        parts.append(f'  {{{head}, "figures": [\n{lines}\n  ]}}')
    return f'{{"bench": {_json(bench)}, "runs": [\n' + ",\n".join(parts) + "\n]}\n"


def show(title: str, run: Run, console: Console) -> None:
    """The run as a table."""
    table = Table("Figure", "Measured", "Lowest – highest", "Target", "", title=title, title_justify="left")
    for one in run.figures:
        measured = f"{number(one.value)} {one.unit}" if one.value is not None else one.missing
        among = "" if one.low is None or one.high is None else f"{number(one.low)} – {number(one.high)}"
        verdict = {True: "[green]met[/]", False: "[red]missed[/]", None: ""}[one.met]
        table.add_row(one.name, measured.strip(), among, one.target, verdict)
    console.print(table)
    console.print(f"{run.command} on {run.date}, commit {run.commit}: {run.machine}", markup=False)


def number(value: float) -> str:
    """Three significant digits or more, thousands apart."""
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"


def _rounded(value: float | None) -> float | None:
    if value is None or isinstance(value, int):
        return value
    return float(f"{value:.4g}") if abs(value) < 1000 else round(value)


def _json(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False)
