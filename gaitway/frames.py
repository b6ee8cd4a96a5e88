"""Metrics as data frames of pandas or polars, imported where one is asked for, or as a line of text."""

import importlib
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any

from gaitway.errors import MissingExtra
from gaitway.schema import MetricsRow

# The return, by the metrics that say it best first.
RETURNS = ("eval/episode_reward", "training/episode_reward")
_BARS = "▁▂▃▄▅▆▇█"
SPARKLINE_WIDTH = 24


def maker(as_: str) -> Callable[[Sequence[MetricsRow]], Any]:
    """A function that converts rows to the kind asked for: `rows`, `pandas` or `polars`.

    Raises ValueError for another kind, and MissingExtra where its package is not installed.
    """
    if as_ == "rows":
        return lambda rows: rows
    if as_ not in ("pandas", "polars"):
        raise ValueError(f"Metrics come as 'rows', 'pandas' or 'polars', not as {as_!r}.")
    made = package(as_)
    return lambda rows: made.DataFrame(columns(rows))


def package(name: str) -> Any:
    """The package that makes data frames. Raises MissingExtra where it is not installed."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise MissingExtra(f"A data frame of {name} needs that package: `pip install {name}`.") from error


def errors_over_time(pandas: Any, found: Mapping[str, Any]) -> Any:
    """The frame of `clip_errors`. found: `over_time` of a battery."""
    by_clip = dict[str, Any]()
    for one in found["clips"]:
        bins = len(one["joints"])
        times = pandas.Index([one["seconds"] * (bin + 0.5) / bins for bin in range(bins)], name="time_s")
        parts = {
            part: pandas.DataFrame(one[part], times, found[part], dtype=float)
            for part in ("joints", "bodies")
        }
        by_clip[one["clip"]] = pandas.concat(parts, axis=1)
    return pandas.concat(by_clip, names=["clip"])


def only(names: Sequence[str], rows: Sequence[MetricsRow]) -> list[MetricsRow]:
    """The rows that have one of these metrics, without their other ones."""
    chosen = [({name: row.values[name] for name in row.values if name in names}, row) for row in rows]
    return [row.model_copy(update={"values": values}) for values, row in chosen if values]


def columns(rows: Sequence[MetricsRow]) -> dict[str, list[Any]]:
    """`step`, `time`, then every metric by name; None where a row has no finite value."""
    names = sorted({name for row in rows for name in row.values})
    return {
        "step": [row.step for row in rows],
        "time": [row.time for row in rows],
        **{name: [row.values.get(name) for row in rows] for name in names},
    }


def sparkline(values: Sequence[float], width: int = SPARKLINE_WIDTH) -> str:
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
