"""The documents of jobs, sweeps, environments and algorithms, made of their records and rows.

An attempt's lease token is never part of one.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from datetime import datetime
from typing import Any, Generic, TypeVar, get_args
from urllib.parse import quote

from fastapi import Response
from pydantic import BaseModel, ConfigDict, TypeAdapter

from core.algorithms.catalog import ALGORITHMS, environment_options, resolve, tuned
from core.environments.info import Device, EnvironmentInfo
from core.errors import Rejected
from core.jobs.job import Artifact, Job, Progress, UnreadableJob
from core.jobs.slots import WantedSlots
from core.jobs.spec import SentSpec
from core.jobs.status import JobStatus
from core.jobs.workers import WorkerInfo, what_it_waits_for
from core.reasons import Reason
from core.rendering.layout import TRACK
from core.sweeps import pbt
from core.sweeps.advance import num_trials
from core.sweeps.results import best, by_seed, judged, metrics_of
from core.sweeps.spec import SweepSpec
from core.sweeps.sweep import Sweep, Trial
from gaitway.schema import (
    ArtifactView,
    AttemptView,
    EnvironmentDetails,
    EnvironmentView,
    GroupView,
    JobView,
    OriginView,
    ProgressView,
    RemovedView,
    SliceView,
    SlotsView,
    SlotView,
    SweepDetails,
    SweepView,
    TrialView,
    TurnView,
)

Item = TypeVar("Item")
_SENT_SPEC: TypeAdapter[SentSpec] = TypeAdapter(SentSpec)
Jobs = Mapping[str, Job | UnreadableJob]
_OF_A_TRIAL = {
    *("number", "job", "message", "parameters", "values", "parent", "gpu_hours", "created_at", "finished_at")
}


def answer(view: BaseModel, status: int = 200, headers: Mapping[str, str] | None = None) -> Response:
    """The view as JSON, written where the route runs: in a thread.

    The framework would validate the view again, and write it in the event loop, where everybody else waits.
    """
    return Response(view.model_dump_json(), status, headers, media_type="application/json")


class ServiceAnswer(BaseModel):
    """A document that the service alone knows."""

    model_config = ConfigDict(frozen=True)


class Listing(ServiceAnswer, Generic[Item]):
    """A page of items, and the cursor of the next page; null at the end."""

    items: Sequence[Item]
    next: str | None = None


class JobsListing(Listing[JobView]):
    """of_newest: how many of the newest jobs a sorted list is of, where it leaves older ones out."""

    of_newest: int | None = None


class Health(ServiceAnswer):
    """status: `ok`; anything else is a problem."""

    status: str = "ok"


def artifact_view(job_id: str, artifact: Artifact) -> ArtifactView:
    href = f"/jobs/{job_id}/artifacts/{quote(artifact.name, safe='')}"
    return ArtifactView(**artifact.model_dump(exclude={"key"}), href=href)


def job_view(
    job: Job | UnreadableJob,
    workers: Sequence[WorkerInfo] | None = None,
    turns: Mapping[str, TurnView] | None = None,
    sweep: str | None = None,
) -> JobView:
    """workers, turns: the present ones, for a document that says what the job waits for. sweep: its id."""
    if isinstance(job, UnreadableJob):
        return _unreadable_view(job, sweep)
    progress = job.progress if job.status.is_held else job.progress.model_copy(update={"phase": None})
    return JobView(
        id=job.id,
        kind=job.spec.kind,
        name=job.spec.name,
        labels=dict(job.spec.labels),
        note=job.spec.note,
        status=job.status,
        reason=job.reason,
        message=job.message,
        created_at=job.created_at,
        started_at=job.started_at,
        finished_at=job.finished_at,
        not_before=job.not_before,
        waiting_for=None if workers is None else what_it_waits_for(job, workers),
        turn=None if turns is None or job.status != JobStatus.QUEUED else _turn(job, turns.get(job.id)),
        owner=job.owner,
        project=job.project,
        sweep=sweep,
        imported_from=None if job.imported_from is None else OriginView.model_validate(job.imported_from),
        removed=tuple(
            RemovedView(rule=one.rule, at=one.at, files=one.files, bytes=one.size) for one in job.removed
        ),
        correlation_id=job.correlation_id,
        progress=ProgressView.model_validate(progress),
        attempts=tuple(AttemptView.model_validate(attempt) for attempt in job.attempts),
        artifacts=tuple(artifact_view(job.id, artifact) for artifact in job.artifacts),
        spec=_SENT_SPEC.dump_python(job.spec, mode="json"),
        links=_links(job),
    )


def _turn(job: Job, turn: TurnView | None) -> TurnView | None:
    """A job that made room for another one says so while it waits."""
    last = job.attempts[-1] if job.attempts else None
    if turn is None or last is None or last.reason != Reason.PREEMPTED:
        return turn
    return turn.model_copy(update={"reason": f"{last.message} It goes on later. {turn.reason}"})


def _unreadable_view(job: UnreadableJob, sweep: str | None) -> JobView:
    return JobView(
        sweep=sweep,
        **job.model_dump(
            include={"id", "kind", "name", "labels", "note", "status", "spec", "owner", "project"}
        ),
        reason="unreadable",
        message=f"This version of Gaitway cannot read the job's record ({job.problem}).",
        created_at=job.created_at,
        started_at=job.started_at,
        finished_at=job.finished_at,
        progress=ProgressView.model_validate(Progress()),
        attempts=(),
        artifacts=(),
        links=_links(job),
    )


def _links(job: Job | UnreadableJob) -> dict[str, str]:
    here = f"/jobs/{job.id}"
    parts = ["events", "metrics", "logs", "checkpoints", "artifacts", "policy", "video", "poster"]
    parts += ["replay", "specification", "export", "curve"]
    links = {"self": here, **{part: f"{here}/{part}" for part in parts}}
    links["report"] = f"{here}/report.html"
    return links if job.status.is_final else {**links, "cancel": f"{here}/cancel"}


def sweep_view(sweep: Sweep, trials: Sequence[Trial], jobs: Jobs, now: datetime) -> SweepView:
    present = _present(sweep, trials, jobs, now)
    return SweepView(**_sweep_facts(sweep, present, _views(sweep.spec, present, jobs)))


def sweep_details(sweep: Sweep, trials: Sequence[Trial], jobs: Jobs, now: datetime) -> SweepDetails:
    present = _present(sweep, trials, jobs, now)
    views = _views(sweep.spec, present, jobs)
    return SweepDetails(
        **_sweep_facts(sweep, present, views),
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


def _trial_view(trial: Trial, job: Job | UnreadableJob | None, generation: int | None) -> TrialView:
    status = trial.outcome or ("pruned" if trial.is_pruned else job.status if job else "queued")
    facts = trial.model_dump(include=_OF_A_TRIAL)
    return TrialView(status=status, step=trial.steps, generation=generation, **facts)


def _sweep_facts(sweep: Sweep, trials: Sequence[Trial], seen: Sequence[TrialView]) -> dict[str, Any]:
    here, spec = f"/sweeps/{sweep.id}", sweep.spec
    views = {view.number: view for view in seen}
    links = {"self": here, "jobs": f"/jobs?label=sweep:{sweep.id}"}
    links |= {"resume": f"{here}/resume"} if sweep.status.is_final else {"cancel": f"{here}/cancel"}
    return {
        **sweep.model_dump(
            include={"id", "status", "message", "created_at", "finished_at", "owner", "project"}
        ),
        "name": spec.name,
        "labels": spec.labels,
        "note": spec.note,
        "spec": spec.model_dump(mode="json"),
        "num_trials": dict(Counter(view.status for view in views.values())),
        "max_trials": num_trials(spec, trials),
        "best": [views[trial.number] for trial in best(trials, spec.objectives)],
        "links": links,
    }


class AlgorithmView(ServiceAnswer):
    """An algorithm, and the JSON Schema of its hyperparameters."""

    kind: str
    description: str
    parameters: dict[str, Any]


def environment_view(info: EnvironmentInfo) -> EnvironmentView:
    return EnvironmentView(**_environment_facts(info))


def environment_details(info: EnvironmentInfo) -> EnvironmentDetails:
    return EnvironmentDetails(
        **_environment_facts(info),
        observation=tuple(SliceView.model_validate(one) for one in info.spaces.observation),
        action=tuple(SliceView.model_validate(one) for one in info.spaces.action),
        critic=tuple(SliceView.model_validate(one) for one in info.spaces.critic),
        defaults=_by_algorithm_and_device(lambda kind, device: _defaults(kind, info, device)),
        metrics={kind or "rollout": _metrics(info, kind) for kind in (*ALGORITHMS, None)},
        parts={kind: tuple(names) for kind, names in info.parts.items()},
    )


def _metrics(info: EnvironmentInfo, algorithm: str | None) -> tuple[str, ...]:
    follows_clips = getattr(info.chosen, "reference", None) is not None
    return tuple(sorted(metrics_of(info.id, algorithm, follows_clips=follows_clips)))


def _environment_facts(info: EnvironmentInfo) -> dict[str, Any]:
    return {
        "id": info.id,
        "family": info.family,
        "description": info.description,
        "observation_size": info.observation_size,
        "action_size": info.action_size,
        "dt": info.dt,
        "episode_length": info.episode_length,
        "cameras": (TRACK, *(name for name in info.cameras if name and name != TRACK)),
        "options": info.options.model_json_schema(),
        "tuned": _by_algorithm_and_device(lambda kind, device: tuned(kind, _row_for(kind, info), device)),
        "environment_options": {kind: taken for kind in ALGORITHMS if (taken := _taken(kind, info))},
        "cannot_run": info.cannot_run,
    }


def _by_algorithm_and_device(
    values: Callable[[str, Device], dict[str, Any]],
) -> dict[str, dict[str, dict[str, Any]]]:
    """Without the algorithms and devices for which there are no values."""
    found: dict[str, dict[str, dict[str, Any]]] = {}
    for kind in ALGORITHMS:
        for device in get_args(Device):
            if own := values(kind, device):
                found.setdefault(kind, {})[device] = own
    return found


def _taken(kind: str, info: EnvironmentInfo) -> Mapping[str, Any]:
    """Options that a job on the environment takes because neither it nor these options say them."""
    if info.takes_model:
        return {}
    return environment_options(
        ALGORITHMS[kind].spec(), info.id, info.option_values.model_dump(exclude_unset=True)
    )


def _row_for(kind: str, info: EnvironmentInfo) -> EnvironmentInfo:
    """The environment as a job with this algorithm gets it."""
    if not (taken := _taken(kind, info)):
        return info
    given = info.option_values.model_dump(exclude_unset=True)
    return info.under(info.options.model_validate({**given, **taken}))


def _defaults(kind: str, info: EnvironmentInfo, device: Device) -> dict[str, Any]:
    """Every hyperparameter; none where the algorithm needs more than its defaults."""
    with suppress(Rejected):
        return resolve(ALGORITHMS[kind].spec(), _row_for(kind, info), device).model_dump(mode="json")
    return {}


def slots_view(wanted: Sequence[WantedSlots]) -> SlotsView:
    items = tuple(
        SlotView(
            accelerator=slots.kind.accelerator,
            gpus=slots.kind.gpus,
            hosts=slots.kind.hosts,
            queued=slots.queued,
            running=slots.running,
            oldest_queued_s=slots.oldest_queued_s,
        )
        for slots in wanted
    )
    ages = [item.oldest_queued_s for item in items if item.oldest_queued_s is not None]
    queued, running = sum(item.queued for item in items), sum(item.running for item in items)
    return SlotsView(
        items=items,
        queued=queued,
        running=running,
        wanted=queued + running,
        oldest_queued_s=max(ages, default=None),
    )
