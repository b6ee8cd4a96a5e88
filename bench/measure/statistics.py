"""Statistics of several rounds of one measurement."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import fmean, median, stdev
from typing import TypeVar

Measured = TypeVar("Measured")


@dataclass(frozen=True)
class Spread:
    """The median of some rounds, their minimum and their maximum."""

    median: float
    low: float
    high: float


def spread(values: Sequence[float]) -> Spread:
    """Raises ValueError if there are no values."""
    if not values:
        raise ValueError("There is nothing to take the median of.")
    return Spread(median(values), min(values), max(values))


@dataclass(frozen=True)
class Estimate:
    """The mean over seeds and its standard error: the seeds' deviation (n - 1) over the root of n.

    error: None with one seed, which says nothing about others.
    """

    mean: float
    error: float | None


def estimate(values: Sequence[float]) -> Estimate:
    """Raises ValueError if there are no values."""
    if not values:
        raise ValueError("There is nothing to take the mean of.")
    error = stdev(values) / math.sqrt(len(values)) if len(values) > 1 else None
    return Estimate(fmean(values), error)


def difference_in_errors(ours: Estimate, theirs: Estimate) -> float | None:
    """(ours - theirs) in units of the standard error of that difference, the seeds being independent.

    None if that error is unknown or zero: with one seed, or if all seeds gave the same.
    """
    if ours.error is None or theirs.error is None:
        return None
    error = math.hypot(ours.error, theirs.error)
    return (ours.mean - theirs.mean) / error if error else None


def ratios(numerators: Sequence[float], denominators: Sequence[float]) -> Spread:
    """The ratio of each round, so that what slows a whole round down cancels out."""
    return spread([a / b for a, b in zip(numerators, denominators, strict=True)])


def percentile(values: Sequence[float], percent: float) -> float:
    """The smallest value that at least `percent` % of the values do not exceed (nearest rank)."""
    if not values:
        raise ValueError("There is nothing to take a percentile of.")
    rank = max(1, math.ceil(percent / 100 * len(values)))
    return sorted(values)[rank - 1]


def alternate(rounds: int, **measurements: Callable[[], Measured]) -> dict[str, list[Measured]]:
    """Each measurement once a round, in turn and every other round backwards: A B, B A, A B, …"""
    results: dict[str, list[Measured]] = {name: [] for name in measurements}
    for turn in range(rounds):
        names = list(measurements)
        for name in names if turn % 2 == 0 else reversed(names):
            results[name].append(measurements[name]())
    return results
