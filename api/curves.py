"""Metrics as curves, thinned so that a picture of them shows the same."""

from array import array
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from math import isnan, nan

from api.views import MetricsRow
from core.jobs.measured import Measured


@dataclass
class Curve:
    """One metric of a job: values over rising steps. times: seconds since 1970; nan: not finite."""

    steps: "array[int]" = field(default_factory=lambda: array("q"))
    times: "array[float]" = field(default_factory=lambda: array("d"))
    values: "array[float]" = field(default_factory=lambda: array("d"))

    def __len__(self) -> int:
        return len(self.steps)

    def add(self, step: int, time: float, value: float) -> None:
        """Append a value. One of an earlier step comes from an attempt that began again at a checkpoint: it
        replaces what followed that checkpoint."""
        if self.steps and step <= self.steps[-1]:
            kept = bisect_left(self.steps, step)
            del self.steps[kept:], self.times[kept:], self.values[kept:]
        self.steps.append(step)
        self.times.append(time)
        self.values.append(value)

    def between(self, first_step: int | None, last_step: int | None) -> range:
        """The places of the values of these steps, both included."""
        start = 0 if first_step is None else bisect_left(self.steps, first_step)
        end = len(self) if last_step is None else bisect_right(self.steps, last_step)
        return range(start, max(start, end))


def extremes(values: Sequence[float], places: range, points: int) -> list[int]:
    """At most `points` (4 or more) of these places, in order: the first, the last, and of each of equally
    long parts between them the places of the least and the greatest value.

    A line through them covers the same pixels as one through all values, if the picture has at most half of
    `points` columns. Values that are nan count only where a part has no others.
    """
    if len(places) <= points:
        return list(places)
    inner, num_parts = places[1:-1], (points - 2) // 2
    kept = [places[0]]
    for part in range(num_parts):
        within = inner[part * len(inner) // num_parts : (part + 1) * len(inner) // num_parts]
        numbers = [place for place in within if not isnan(values[place])] or within[:1]
        kept += sorted({min(numbers, key=values.__getitem__), max(numbers, key=values.__getitem__)})
    return [*kept, places[-1]]


class Curves(dict[str, Curve]):
    """Metrics by name."""

    def add(self, measured: Measured, names: frozenset[str] | None) -> None:
        """Append the values; names: only these metrics."""
        for name, value in measured.said.values.items():
            if names is None or name in names:
                if (curve := self.get(name)) is None:
                    curve = self[name] = Curve()
                curve.add(measured.said.step, measured.time, nan if value is None else value)

    @property
    def num_values(self) -> int:
        return sum(map(len, self.values()))

    def thinned(
        self, names: frozenset[str] | None, points: int, first_step: int | None, last_step: int | None
    ) -> list[MetricsRow]:
        """Rows with at most `points` values of each metric, in the order of their steps and times."""
        rows: dict[tuple[int, float], dict[str, float | None]] = {}
        for name, curve in self.items():
            if names is None or name in names:
                for place in extremes(curve.values, curve.between(first_step, last_step), points):
                    row = rows.setdefault((curve.steps[place], curve.times[place]), {})
                    row[name] = curve.values[place]
        return [
            MetricsRow(step=step, time=datetime.fromtimestamp(time, UTC), values=values)
            for (step, time), values in sorted(rows.items(), key=lambda row: row[0])
        ]
