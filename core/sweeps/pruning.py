"""When a trial is not worth its steps: rules over the curves of all trials, in which more is better.

Optuna's pruners keep what they decided in a storage of their own; these depend on the curves alone, so a
process that dies loses nothing.
"""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from math import isfinite
from statistics import median

from core.errors import JobNotFound
from core.jobs import feeds
from core.jobs.store import JobStore
from core.storage.objects import ObjectStore
from core.sweeps.spec import HyperbandPruning, MedianPruning
from core.sweeps.sweep import Curve


def is_to_prune(
    pruning: MedianPruning | HyperbandPruning,
    number: int,
    curves: Mapping[int, Curve],
    ended: Collection[int],
) -> bool:
    """Whether trial `number` is to end now. curves: of all trials; ended: the numbers of those that ended."""
    if not curves[number]:
        return False
    match pruning:
        case MedianPruning():
            return _is_below_median(pruning, number, curves, ended)
        case HyperbandPruning():
            return _has_lost_a_rung(pruning, number, curves)


def _is_below_median(
    pruning: MedianPruning, number: int, curves: Mapping[int, Curve], ended: Collection[int]
) -> bool:
    own = curves[number]
    step = max(own)
    if step < pruning.warmup_steps or len(ended) < pruning.startup_trials:
        return False
    others = [value for other in ended if (value := value_at(curves[other], step)) is not None]
    return bool(others) and max(own.values()) < median(others)


def value_at(curve: Curve, step: int) -> float | None:
    """The last value up to this step; None if the curve begins later or ends before."""
    if not curve or step > max(curve):
        return None
    before = [at for at in curve if at <= step]
    return curve[max(before)] if before else None


def _has_lost_a_rung(pruning: HyperbandPruning, number: int, curves: Mapping[int, Curve]) -> bool:
    """Whether it is not among the best of its bracket at the last rung that it has reached."""
    bracket = number % pruning.brackets
    reached = [
        (rung, at)
        for rung in _rungs(pruning, bracket, max(curves[number]))
        if (at := _first_value_from(curves[number], rung)) is not None
    ]
    if not reached:
        return False
    rung, own = reached[-1]
    rivals = [
        value
        for other, curve in curves.items()
        if other % pruning.brackets == bracket and (value := _first_value_from(curve, rung)) is not None
    ]
    kept = max(1, len(rivals) // pruning.reduction_factor)
    # Before a rung has seen enough trials to drop one, all of them go on.
    return len(rivals) >= pruning.reduction_factor and own < sorted(rivals, reverse=True)[kept - 1]


def _rungs(pruning: HyperbandPruning, bracket: int, until: int) -> Iterator[int]:
    rung = pruning.min_steps * pruning.reduction_factor**bracket
    while rung <= until:
        yield rung
        rung *= pruning.reduction_factor


def _first_value_from(curve: Curve, step: int) -> float | None:
    """The first value at this step or later: evaluations rarely fall on a rung."""
    later = [at for at in curve if at >= step]
    return curve[min(later)] if later else None


@dataclass
class _Known:
    """last: the number of the last entry that was read. is_whole: the job had ended before that."""

    last: int = 0
    is_whole: bool = False
    values: dict[int, float] = field(default_factory=dict[int, float])


class ObjectiveCurves:
    """The objective's values of running trials, read from their events; only what came since is read again.

    A process without this cache reads the feeds from the beginning and finds the same.
    """

    def __init__(self, store: JobStore, objects: ObjectStore) -> None:
        self._store = store
        self._objects = objects
        self._known: dict[tuple[str, str], _Known] = {}

    def read(self, job_id: str | None, metric: str, *, has_ended: bool) -> Curve:
        """The values by step; empty for a job that is gone. Raises the errors of `feeds.read_metrics`."""
        if job_id is None:
            return {}
        known = self._known.setdefault((job_id, metric), _Known())
        if known.is_whole:
            return known.values
        try:
            self._read_on(job_id, metric, known)
        except JobNotFound:
            self._known.pop((job_id, metric))
            return {}
        known.is_whole = has_ended
        return dict(known.values)

    def _read_on(self, job_id: str, metric: str, known: _Known) -> None:
        parts = feeds.read_metrics(
            job_id, store=self._store, objects=self._objects, after=known.last, names=[metric]
        )
        for block, last in parts:
            # An attempt that resumed at a checkpoint reports steps again; the newest value counts.
            steps, _, values = block.column(metric)
            found = zip(steps, values, strict=True)
            known.values.update((step, value) for step, value in found if isfinite(value))
            known.last = last
