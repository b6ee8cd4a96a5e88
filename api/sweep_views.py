"""The documents of sweeps, made of their records."""

from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

from core.jobs.job import Job, UnreadableJob
from core.sweeps import pbt
from core.sweeps.advance import num_trials
from core.sweeps.results import best, by_seed, judged
from core.sweeps.spec import SweepSpec
from core.sweeps.sweep import Sweep, Trial
from gaitway.schema import GroupView, SweepDetails, SweepView, TrialView

Jobs = Mapping[str, Job | UnreadableJob]


def sweep_view(sweep: Sweep, trials: Sequence[Trial], jobs: Jobs, now: datetime) -> SweepView:
    present = _present(sweep, trials, jobs, now)
    return SweepView(**_facts(sweep, present, _views(sweep.spec, present, jobs)))


def sweep_details(sweep: Sweep, trials: Sequence[Trial], jobs: Jobs, now: datetime) -> SweepDetails:
    present = _present(sweep, trials, jobs, now)
    views = _views(sweep.spec, present, jobs)
    return SweepDetails(
        **_facts(sweep, present, views),
        trials=tuple(views),
        groups=tuple(GroupView.model_validate(one) for one in by_seed(present, len(sweep.spec.objectives))),
        importance=sweep.importance,
        importance_note=sweep.importance_note,
    )


def _present(sweep: Sweep, trials: Sequence[Trial], jobs: Jobs, now: datetime) -> Sequence[Trial]:
    """The trials with what their jobs report now."""
    return [judged(trial, jobs.get(trial.job or ""), sweep.spec.objectives, now) for trial in trials]


def _views(spec: SweepSpec, trials: Sequence[Trial], jobs: Jobs) -> Sequence[TrialView]:
    population = spec.population
    generations = [None] * len(trials) if population is None else pbt.generations(population, trials)
    return [
        _trial_view(trial, jobs.get(trial.job or ""), generation)
        for trial, generation in zip(trials, generations, strict=True)
    ]


_OF_A_TRIAL = {
    *("number", "job", "message", "parameters", "values", "parent", "gpu_hours", "created_at", "finished_at")
}


def _trial_view(trial: Trial, job: Job | UnreadableJob | None, generation: int | None) -> TrialView:
    status = trial.outcome or ("pruned" if trial.is_pruned else job.status if job else "queued")
    facts = trial.model_dump(include=_OF_A_TRIAL)
    return TrialView(status=status, step=trial.steps, generation=generation, **facts)


def _facts(sweep: Sweep, trials: Sequence[Trial], seen: Sequence[TrialView]) -> dict[str, Any]:
    here, spec = f"/sweeps/{sweep.id}", sweep.spec
    views = {view.number: view for view in seen}
    links = {"self": here, "jobs": f"/jobs?label=sweep:{sweep.id}"}
    links |= {"resume": f"{here}/resume"} if sweep.status.is_final else {"cancel": f"{here}/cancel"}
    return {
        **sweep.model_dump(include={"id", "status", "message", "created_at", "finished_at"}),
        "name": spec.name,
        "labels": spec.labels,
        "spec": spec.model_dump(mode="json"),
        "num_trials": dict(Counter(view.status for view in views.values())),
        "max_trials": num_trials(spec, trials),
        "best": [views[trial.number] for trial in best(trials, spec.objectives)],
        "links": links,
    }
