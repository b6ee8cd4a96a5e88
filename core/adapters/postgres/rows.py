"""Jobs to rows, and rows to jobs with their attempts and artifacts."""

import json
from collections import defaultdict
from collections.abc import Collection, Sequence
from datetime import timedelta
from typing import Any, cast

from pydantic import ValidationError
from pydantic_core import from_json
from sqlalchemy import (
    ARRAY,
    JSON,
    Connection,
    Double,
    Row,
    Text,
    any_,
    bindparam,
    case,
    exists,
    func,
    literal,
    literal_column,
    or_,
    select,
)
from sqlalchemy import cast as cast_to
from sqlalchemy.dialects.postgresql import aggregate_order_by

from core.adapters.postgres.engine import DriverStatement
from core.adapters.postgres.tables import NOW, UNFINISHED, artifacts, attempts, clip_files, jobs, sweeps
from core.bounds import LONGEST_MESSAGE
from core.documents import read_leniently
from core.errors import JobNotFound, JobUnreadable
from core.jobs.job import Artifact, Attempt, Job, Progress, UnreadableJob
from core.jobs.patch import JobPatch
from core.jobs.queue import queue_of
from core.jobs.sharing import alike
from core.jobs.spec import JOB_SPEC, EnvironmentSpec, Source, TrainSpec, decoder_job, experts_of
from core.jobs.status import JobStatus
from core.jobs.uploads import clip_files_of

Values = dict[str, Any]
HELD = tuple(status.value for status in JobStatus if status.is_held)

# An array is one parameter: the statement is the same for any number of ids, and PostgreSQL has it prepared.
IDS = bindparam("ids", type_=ARRAY(Text))
_ATTEMPTS_OF = select(attempts).where(attempts.c.job_id == any_(IDS)).order_by(attempts.c.number)
_ARTIFACTS_OF = select(artifacts).where(artifacts.c.job_id == any_(IDS)).order_by(artifacts.c.position)
# A job with all of its attempts and files: each further statement would be a round trip.
_FIND = DriverStatement(
    select(
        jobs,
        *(
            select(func.json_agg(aggregate_order_by(literal_column(table.name, JSON), order)))
            .select_from(table)
            .where(table.c.job_id == jobs.c.id)
            .correlate(jobs)
            .scalar_subquery()
            .label(table.name)
            for table, order in ((attempts, attempts.c.number), (artifacts, artifacts.c.position))
        ),
    ).where(jobs.c.id == bindparam("id", type_=Text))
)
# In listings, whose readers look at the newest; a job itself has them all.
_MOST_LISTED = 10
_LONGEST_LISTED = 1000


def _brief_attempts() -> Any:
    from_last = func.row_number().over(partition_by=attempts.c.job_id, order_by=attempts.c.number.desc())
    shown = [column for column in attempts.c if column.name not in ("details", "message")]
    found = (
        select(
            *shown,
            literal("{}").label("details"),
            func.left(attempts.c.message, _LONGEST_LISTED).label("message"),
            from_last.label("place"),
        )
        .where(attempts.c.job_id == any_(IDS))
        .subquery()
    )
    return select(found).where(found.c.place <= _MOST_LISTED).order_by(found.c.number)


def _brief_artifacts() -> Any:
    """The newest of each role; one without a step was made at the job's end."""
    from_last = func.row_number().over(
        partition_by=(artifacts.c.job_id, artifacts.c.role),
        order_by=(artifacts.c.step.desc().nulls_first(), artifacts.c.position.desc()),
    )
    shown = [column for column in artifacts.c if column.name != "metadata"]
    facts = case(
        (func.octet_length(artifacts.c.metadata) <= _LONGEST_LISTED, artifacts.c.metadata), else_="{}"
    )
    found = (
        select(*shown, facts.label("metadata"), from_last.label("place"))
        .where(artifacts.c.job_id == any_(IDS))
        .subquery()
    )
    return select(found).where(found.c.place <= _MOST_LISTED).order_by(found.c.position)


_BRIEF_ATTEMPTS_OF, _BRIEF_ARTIFACTS_OF = _brief_attempts(), _brief_artifacts()


# The columns of `jobs` that change with the version; the store adds the counters and the lease.
CHANGING = (
    "version",
    "status",
    "reason",
    "message",
    "started_at",
    "finished_at",
    "not_before",
    "token",
    "num_attempts",
    "queue",
    "bytes",
    "device",
    "engine",
)


def job_values(job: Job) -> Values:
    """The columns that change with the version."""
    return {
        "version": job.version,
        "status": job.status.value,
        "reason": job.reason,
        "message": words(job.message),
        "started_at": job.started_at,
        "finished_at": job.finished_at,
        "not_before": job.not_before,
        "token": job.token,
        "num_attempts": len(job.attempts),
        "queue": queue_of(job),
        "bytes": sum(artifact.size for artifact in job.artifacts),
        "device": job.device,
        "engine": job.engine,
    }


def new_job_values(job: Job) -> Values:
    """All columns of a new job."""
    spec = job.spec
    return {
        **job_values(job),
        "id": job.id,
        "kind": spec.kind,
        "environment": spec.environment.id,
        "name": spec.name,
        "labels": spec.labels,
        "note": spec.note,
        "model": _text(spec.environment.options.get("model")),
        "clip_files": list(clip_files_of(spec.environment)),
        "gpu_bytes": spec.resources.gpu_bytes,
        "alike": _alike(job),
        "preemptible": isinstance(spec, TrainSpec) and spec.preemptible,
        "source": None if spec.source is None else spec.source.job,
        "source_step": None if spec.source is None else spec.source.step,
        "decoder": decoder_job(spec.environment),
        "experts": experts_of(spec),
        "spec": json.dumps(job.model_dump(mode="json", include={"spec"})["spec"]),
        "created_at": job.created_at,
        "progress": None if job.progress == Progress() else job.progress.model_dump_json(),
        "imported_from": None if job.imported_from is None else job.imported_from.model_dump_json(),
        "owner": job.owner,
        "project": job.project,
        "correlation_id": job.correlation_id,
    }


def _alike(job: Job) -> str | None:
    """What a job that shares a GPU and does not say how much of it has in common with those like it."""
    spec = job.spec
    is_asked = spec.resources.share_gpu and spec.resources.gpu_bytes is None
    waits = job.status == JobStatus.QUEUED
    return alike(spec) if is_asked and waits and isinstance(spec, TrainSpec) else None


def patch_values(spec: Values, patch: JobPatch) -> Values:
    """The columns that a patch changes. spec: as it is under the patch."""
    named = {name: spec.get(name, {} if name == "labels" else None) for name in patch.model_fields_set}
    return {**named, "spec": json.dumps(spec)}


def _text(value: object) -> str | None:
    return value if isinstance(value, str) else None


def attempt_values(job_id: str, attempt: Attempt) -> Values:
    fields = attempt.model_dump()
    return {
        **fields,
        "job_id": job_id,
        "message": words(attempt.message),
        "details": json.dumps(attempt.model_dump(mode="json")["details"]),
    }


def artifact_values(job_id: str, position: int, artifact: Artifact) -> Values:
    facts = json.dumps(artifact.model_dump(mode="json")["metadata"])
    return {**artifact.model_dump(), "job_id": job_id, "position": position, "metadata": facts}


def age_s(moment: Any) -> Any:
    """Its age in seconds; NULL for none."""
    return case((moment.is_not(None), cast_to(func.greatest(0, func.extract("epoch", NOW - moment)), Double)))


def columns(row: Row[Any]) -> Values:
    return dict(row._mapping)  # pyright: ignore[reportPrivateUsage] # Public, by SQLAlchemy's documentation.


def find_job(connection: Connection, job_id: str) -> Job | UnreadableJob:
    """Raises JobNotFound."""
    found = _FIND.rows(connection, {"id": job_id})
    if not found:
        raise JobNotFound(job_id[:64])
    return _job(found[0], found[0]["attempts"] or (), found[0]["artifacts"] or ())


def jobs_of_rows(
    connection: Connection, found: Sequence[Any], *, brief: bool = False
) -> list[Job | UnreadableJob]:
    """The jobs of these rows, with at most two queries for all of them together.

    brief: with their newest attempts and files alone, and without what these say at length about themselves.
    """
    if not found:
        return []
    ids = {"ids": [row.id for row in found]}
    tries: dict[str, list[Values]] = defaultdict(list)
    files: dict[str, list[Values]] = defaultdict(list)
    if any(row.num_attempts for row in found):
        for row in connection.execute(_BRIEF_ATTEMPTS_OF if brief else _ATTEMPTS_OF, ids):
            tries[row.job_id].append(columns(row))
    for row in connection.execute(_BRIEF_ARTIFACTS_OF if brief else _ARTIFACTS_OF, ids):
        files[row.job_id].append(columns(row))
    return [_job(columns(row), tries[row.id], files[row.id]) for row in found]


def hold_job(connection: Connection, job_id: str) -> bool:
    """Whether the job exists; if so, nobody deletes it before the transaction ends."""
    row = select(jobs.c.id).where(jobs.c.id == job_id).with_for_update(read=True, key_share=True)
    return connection.execute(row).first() is not None


def hold_source(connection: Connection, source: Source) -> bool:
    """`hold_job` of the source; False also where a retention rule has removed the checkpoint of its step."""
    if not hold_job(connection, source.job):
        return False
    if source.step is None:
        return True
    has_lost = select(jobs.c.id).where(
        jobs.c.id == source.job,
        jobs.c.removed.is_not(None),
        ~exists().where(
            artifacts.c.job_id == source.job,
            artifacts.c.role == "checkpoint",
            artifacts.c.step == source.step,
        ),
    )
    return connection.execute(has_lost).first() is None


def hold_clips(connection: Connection, environment: EnvironmentSpec) -> Sequence[str]:
    """The clip files that it names and that do not exist; nobody deletes the others before the transaction
    ends."""
    named = clip_files_of(environment)
    if not named:
        return ()
    ids = select(clip_files.c.id).where(clip_files.c.id.in_(named)).order_by(clip_files.c.id)
    held = set(connection.execute(ids.with_for_update(read=True, key_share=True)).scalars())
    return [file for file in named if file not in held]


def users_of(upload_id: str) -> Any:
    """The unfinished jobs that need this model or file of clips: `id`, `project`."""
    names = or_(jobs.c.model == upload_id, literal(upload_id) == any_(jobs.c.clip_files))
    wanted = select(jobs.c.id, jobs.c.project).where(jobs.c.status.in_(UNFINISHED), names)
    return wanted.order_by(jobs.c.id)


def sweeps_naming(name: str, projects: Collection[str] | None = None) -> Any:
    """The ids of the unfinished sweeps that name this job, model or file of clips, among their axes' values,
    too. projects: those in which they are; None: any."""
    names_it = sweeps.c.spec.contains(name, autoescape=True)
    wanted = select(sweeps.c.id).where(sweeps.c.finished_at.is_(None), names_it).order_by(sweeps.c.id)
    return wanted if projects is None else wanted.where(sweeps.c.project.in_(projects))


def readable(job: Job | UnreadableJob) -> Job:
    """Raises JobUnreadable."""
    if isinstance(job, UnreadableJob):
        raise JobUnreadable(job.id, job.problem)
    return job


def _job(own: Values, tries: Sequence[Values], files: Sequence[Values]) -> Job | UnreadableJob:
    """The job; an UnreadableJob if its row is damaged or another version wrote it. own: its row."""
    try:
        found = {
            "spec": read_leniently(own["spec"], JOB_SPEC),
            "attempts": [_attempt_of(attempt) for attempt in tries],
            "artifacts": [_artifact_of(artifact) for artifact in files],
            "progress": _progress(own["progress"]),
            "imported_from": None if own["imported_from"] is None else from_json(own["imported_from"]),
            "removed": () if own["removed"] is None else from_json(own["removed"]),
        }
        return Job.model_validate({**own, **found})
    except ValueError as error:  # JSON's and pydantic's errors are of this kind.
        found = {"status": status(own["status"]), "spec": document(own["spec"]), "problem": _problem(error)}
        return UnreadableJob.model_validate({**own, **found})


def _attempt_of(values: Values) -> Attempt:
    return Attempt.model_validate({**values, "details": from_json(values["details"])})


def _artifact_of(values: Values) -> Artifact:
    return Artifact.model_validate({**values, "metadata": from_json(values["metadata"])})


def _progress(text: str | None) -> Progress:
    try:
        return Progress.model_validate_json(text) if text else Progress()
    except ValidationError:  # The next report replaces it.
        return Progress()


def document(text: str) -> Values:
    """What a specification says, whatever version wrote it; empty for one that is damaged."""
    try:
        spec = json.loads(text)
    except ValueError:
        return {}
    return cast("Values", spec) if isinstance(spec, dict) else {}


def _problem(error: ValueError) -> str:
    first = error.errors()[0] if isinstance(error, ValidationError) else None
    return f"{'/'.join(map(str, first['loc']))}: {first['msg']}" if first else str(error)


def status(text: str) -> JobStatus:
    """A status that this version does not know becomes `running`, so that nobody deletes the job."""
    try:
        return JobStatus(text)
    except ValueError:
        return JobStatus.RUNNING


def words(text: str | None) -> str | None:
    """A message, which may be the tail of a log, without U+0000: PostgreSQL does not store that as text."""
    if text is None:
        return None
    short = text if len(text) <= LONGEST_MESSAGE else f"{text[: LONGEST_MESSAGE - 1]}…"
    return short.replace("\0", "\N{REPLACEMENT CHARACTER}")


def interval(span: timedelta) -> timedelta:
    """At least a millisecond: PostgreSQL would round less to nothing."""
    return max(span, timedelta(milliseconds=1))
