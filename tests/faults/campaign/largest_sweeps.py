"""Gives a sweep all trials but one of those that it may have, each ended, as if they had run."""

from typing import Any

from core.sweeps.spec import MAX_TRIALS
from core.sweeps.sweep import SweepStore, Trial


def fill(sweep_id: str, store: SweepStore) -> None:
    sweep = store.get_sweep(sweep_id)
    there = {trial.number for trial in store.trials([sweep_id]).get(sweep_id, ())}
    axes: dict[str, Any] = sweep.spec.parameters
    for number in set(range(MAX_TRIALS - 1)) - there:
        values = {name: axis[number % len(axis)] for name, axis in axes.items()}
        trial = Trial(
            number=number,
            job=None,
            parameters=values,
            outcome="succeeded",
            values=(float(number % 17),),
            steps=1000,
            created_at=sweep.created_at,
            finished_at=sweep.created_at,
        )
        store.add_trial(sweep_id, trial, None)
