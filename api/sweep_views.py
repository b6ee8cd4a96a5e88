"""Sweeps as clients see them."""

from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any, Self

from pydantic import Field, JsonValue

from api.views import View
from core.jobs.job import Job, UnreadableJob
from core.sweeps import pbt
from core.sweeps.advance import num_trials
from core.sweeps.groups import best, by_seed
from core.sweeps.judging import judged
from core.sweeps.spec import SweepSpec
from core.sweeps.sweep import Sweep, SweepStatus, Trial

Jobs = Mapping[str, Job | UnreadableJob]


class TrialView(View):
    """One setting, and the job that tries it.

    status: its job's; or `pruned`, `refused` if its values did not fit each other, `deleted` if its job was.
    values: the objectives' last values, in their order; null where the job reported none. step: the steps
    that it took itself. By `pbt`: generation, the first is 0; parent, the number of the trial from whose
    checkpoint it resumed.
    """

    number: int = Field(examples=[0])
    job: str | None = Field(examples=["019aa3c2f0b1-5be0c1d2e3"])
    status: str = Field(examples=["succeeded"])
    message: str | None
    parameters: dict[str, JsonValue] = Field(examples=[{"algorithm.learning_rate": 3e-4, "seed": 1}])
    values: Sequence[float | None] = Field(examples=[[2941.5]])
    step: int
    generation: int | None
    parent: int | None
    gpu_hours: float
    created_at: datetime
    finished_at: datetime | None

    @classmethod
    def of(cls, trial: Trial, job: Job | UnreadableJob | None, generation: int | None) -> Self:
        status = trial.outcome or ("pruned" if trial.is_pruned else job.status if job else "queued")
        facts = trial.model_dump(include=_OF_A_TRIAL)
        return cls(status=status, step=trial.steps, generation=generation, **facts)


_OF_A_TRIAL = {
    *("number", "job", "message", "parameters", "values", "parent", "gpu_hours", "created_at", "finished_at")
}


class GroupView(View):
    """The trials of one setting, which differ in their seeds alone.

    mean, spread (standard deviation): of each objective, over the trials that succeeded.
    """

    parameters: dict[str, JsonValue]
    trials: Sequence[int]
    mean: Sequence[float | None]
    spread: Sequence[float | None]


class SweepView(View):
    """A sweep as it is now.

    num_trials: by status, of those that began. max_trials: the most that its method or its budget allows.
    best: the best trial that succeeded; with several objectives, all that none beats in every one (the Pareto
    front).
    """

    id: str = Field(examples=["019aa3c2f0b1-5be0c1d2e3"])
    name: str | None
    labels: dict[str, str]
    status: SweepStatus
    message: str | None = Field(description="Why it ended, and how its trials did.")
    created_at: datetime
    finished_at: datetime | None
    spec: dict[str, Any]
    num_trials: dict[str, int] = Field(examples=[{"succeeded": 7, "running": 2}])
    max_trials: int
    best: Sequence[TrialView]
    links: dict[str, str]

    @classmethod
    def of(cls, sweep: Sweep, trials: Sequence[Trial], jobs: Jobs, now: datetime) -> Self:
        present = _present(sweep, trials, jobs, now)
        return cls(**_facts(sweep, present, _views(sweep.spec, present, jobs)))


class SweepDetails(SweepView):
    """A sweep with its trials.

    groups: the seeds of each setting together; empty where `seed` is no axis. importance: by objective, the
    share of each axis in what makes trials differ (PED-ANOVA); null, and importance_note says why.
    """

    trials: Sequence[TrialView]
    groups: Sequence[GroupView]
    importance: Mapping[str, Mapping[str, float]] | None
    importance_note: str | None

    @classmethod
    def of(cls, sweep: Sweep, trials: Sequence[Trial], jobs: Jobs, now: datetime) -> Self:
        present = _present(sweep, trials, jobs, now)
        views = _views(sweep.spec, present, jobs)
        return cls(
            **_facts(sweep, present, views),
            trials=views,
            groups=[GroupView.model_validate(one) for one in by_seed(present, len(sweep.spec.objectives))],
            importance=sweep.importance,
            importance_note=sweep.importance_note,
        )


def _present(sweep: Sweep, trials: Sequence[Trial], jobs: Jobs, now: datetime) -> Sequence[Trial]:
    """The trials with what their jobs report now."""
    return [judged(trial, jobs.get(trial.job or ""), sweep.spec.objectives, now) for trial in trials]


def _views(spec: SweepSpec, trials: Sequence[Trial], jobs: Jobs) -> Sequence[TrialView]:
    """Of all trials."""
    population = spec.population
    generations = [None] * len(trials) if population is None else pbt.generations(population, trials)
    return [
        TrialView.of(trial, jobs.get(trial.job or ""), generation)
        for trial, generation in zip(trials, generations, strict=True)
    ]


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
