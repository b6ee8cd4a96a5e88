"""Trials compared: the best ones, and the seeds of one setting together."""

import json
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from operator import ge
from statistics import fmean, stdev

from pydantic import JsonValue

from core.sweeps.spec import Objective
from core.sweeps.sweep import Trial

SEED = "seed"


def best(trials: Sequence[Trial], objectives: Sequence[Objective]) -> list[Trial]:
    """The best trial so far; with several objectives, those that no other one beats in all (Pareto).

    Pruned trials and those that run do not count: their last value is not their end.
    """
    ended = [trial for trial in trials if trial.outcome == "succeeded" and trial.has_values]
    worth = {trial.number: _worth(trial, objectives) for trial in ended}
    if len(objectives) == 1:
        return [max(ended, key=lambda trial: worth[trial.number])] if ended else []
    # One that is better in the first objective, or equal there and better in the next, is never beaten by a
    # later one, so each is compared only with those that nothing has beaten.
    front = list[Trial]()
    for one in sorted(ended, key=lambda trial: worth[trial.number], reverse=True):
        if not any(_beats(worth[other.number], worth[one.number]) for other in front):
            front.append(one)
    return sorted(front, key=lambda trial: trial.number)


def _worth(trial: Trial, objectives: Sequence[Objective]) -> list[float]:
    """Its values, of which more is better."""
    return [one.sign * (value or 0.0) for one, value in zip(objectives, trial.values, strict=True)]


def _beats(one: Sequence[float], other: Sequence[float]) -> bool:
    return one != other and all(map(ge, one, other))


@dataclass(frozen=True)
class Group:
    """The trials of one setting, which differ in their seeds alone.

    mean, spread: of each objective over the trials that succeeded; spread is their standard deviation, None
    of fewer than two.
    """

    parameters: dict[str, JsonValue]
    trials: list[int]
    mean: list[float | None]
    spread: list[float | None]


def by_seed(trials: Sequence[Trial], num_objectives: int) -> list[Group]:
    """One group for each setting; empty where `seed` is no axis."""
    groups: dict[str, list[Trial]] = defaultdict(list)
    for trial in trials:
        if SEED in trial.parameters:
            groups[json.dumps(_setting(trial), sort_keys=True)].append(trial)
    return [_group(members, num_objectives) for members in groups.values()]


def _setting(trial: Trial) -> dict[str, JsonValue]:
    return {name: value for name, value in trial.parameters.items() if name != SEED}


def _group(members: Sequence[Trial], num_objectives: int) -> Group:
    ended = [trial.values for trial in members if trial.outcome == "succeeded" and trial.has_values]
    columns = [[float(row[at] or 0.0) for row in ended] for at in range(num_objectives)]
    return Group(
        _setting(members[0]),
        [trial.number for trial in members],
        [fmean(column) if column else None for column in columns],
        [stdev(column) if len(column) > 1 else None for column in columns],
    )
