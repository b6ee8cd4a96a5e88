"""How a job enters the record: a specification that is submitted, or a run of another service.

The queue gets a submitted job once the record has it; an imported run has ended. Its files are stored first,
and its record last.
"""

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
from threading import Lock, Timer
from typing import IO

import structlog

from core.accounts.principal import NOBODYS, Ownership
from core.algorithms.catalog import environment_options
from core.errors import (
    BadExport,
    ClipsNotFound,
    GaitwayError,
    JobNotFound,
    JobUnreadable,
    NotFound,
    Problem,
    RecordsUnavailable,
    Rejected,
    StorageUnavailable,
)
from core.jobs.checks import check
from core.jobs.decoders import with_decoder
from core.jobs.experts import with_experts
from core.jobs.feeds import store_imported
from core.jobs.job import Artifact, Job, new_job_id
from core.jobs.metrics import Block
from core.jobs.queue import MOST_SUBMITTED, JobQueue, queue_of
from core.jobs.quotas import check_quotas
from core.jobs.source import check_readable, find
from core.jobs.spec import CheckpointPolicy, EnvironmentSpec, JobSpec, RolloutSpec, TrainSpec
from core.jobs.store import Chunk, Dispatch, Entry, Idempotency, JobStore
from core.jobs.uploads import Uploads, named_clips
from core.news.store import NewsStore
from core.storage import keys
from core.storage.objects import ObjectStore
from core.uploads import library
from core.uploads.record import Record, UploadStore

log = structlog.get_logger()


def submit(  # noqa: PLR0913 # All but the specification are named.
    spec: JobSpec,
    *,
    store: JobStore,
    queue: JobQueue,
    ownership: Ownership = NOBODYS,
    readable: Collection[str] | None = None,
    idempotency: Idempotency | None = None,
    acknowledge: Callable[[Dispatch], None] = lambda dispatch: None,
    correlation_id: str | None = None,
) -> Job:
    """Store and queue a job; or return the one that an earlier submission with the same key created.

    The job and its dispatch are stored in one transaction: after that, a loss of Redis cannot lose the job.
    ownership, readable: as in `new_job`. acknowledge: called with the dispatch once the queue has received
    it; without, the reconciler finds out. correlation_id: of the request.
    Raises Rejected, QuotaExceeded, IdempotencyKeyReused, RecordsUnavailable.
    """
    if idempotency is not None and (known := store.remembered(idempotency)) is not None:
        return known
    check_notify(spec, ownership.project, store)
    check_quotas(spec, ownership, store)
    try:
        job = store.add(new_job(spec, store, ownership, readable, correlation_id), idempotency)
    except (JobNotFound, ClipsNotFound):  # What it needs was deleted between the check and this: check again.
        job = store.add(new_job(spec, store, ownership, readable, correlation_id), idempotency)
    log.info("job_submitted", job_id=job.id)
    dispatch = Dispatch("attempt", job.id, job.next_attempt)
    if hand_over_if_room(dispatch, job, queue):
        acknowledge(dispatch)
    return job


def new_job(
    spec: JobSpec,
    store: JobStore,
    ownership: Ownership = NOBODYS,
    readable: Collection[str] | None = None,
    correlation_id: str | None = None,
) -> Job:
    """The job of a submission, checked and not stored yet. Raises Rejected.

    readable: the projects whose checkpoints, models and clips it may use; None: all.
    """
    check_readable_source(spec, readable, store)
    spec = with_decoder(completed(with_environment(spec, store)), store, readable)
    check_readable_uploads(spec.environment, readable, store)
    spec = with_experts(spec, store, readable)
    check(spec, store)
    now = store.now()
    return Job(
        id=new_job_id(now),
        spec=spec,
        created_at=now,
        owner=ownership.owner,
        project=ownership.project,
        correlation_id=correlation_id,
    )


def check_notify(spec: JobSpec, project: str, store: NewsStore) -> None:
    """Refuse names in `notify` that no webhook of the project has.

    For submissions alone: a trial of a sweep begins without a webhook that was deleted meanwhile.
    """
    if not spec.notify:
        return
    known = [webhook.name for webhook in store.webhooks(project)]
    have = f"It has: {', '.join(known)}." if known else "It has none: `gaitway webhooks add` makes one."
    problems = [
        Problem(f"/notify/{place}", f"The project {project} has no webhook {name!r}. {have}")
        for place, name in enumerate(spec.notify)
        if name not in known
    ]
    if problems:
        raise Rejected(problems[0].detail, problems)


def check_readable_source(spec: JobSpec, readable: Collection[str] | None, store: JobStore) -> None:
    """Refuse a checkpoint of a job in another project, in the words for a job that does not exist."""
    if (source := spec.source) is not None:
        check_readable(source.job, readable, store, f"{source.pointer}/job")


def check_readable_uploads(
    environment: EnvironmentSpec, readable: Collection[str] | None, store: Uploads
) -> None:
    """Refuse a model or clips of other projects, in the words for those that do not exist."""
    if readable is None:
        return
    problems: list[Problem] = []
    if isinstance(model := environment.options.get("model"), str):
        problems += _hidden(model, store.models, readable, "model")
    places: dict[str, int] = {}
    for place, file in named_clips(environment):
        places.setdefault(file, place)
    for file, place in places.items():
        problems += _hidden(file, store.clips, readable, f"reference/clips/{place}/file")
    if problems:
        raise Rejected(" ".join(problem.detail for problem in problems[:5]), problems)


def _hidden(
    upload_id: str, store: UploadStore[Record], readable: Collection[str], place: str
) -> Iterator[Problem]:
    """The problem with a file that exists, and that none of these projects has.

    A deleted one that a job still needs is in no project.
    """
    owners = store.owners_of([upload_id]).get(upload_id, ())
    if any(one.project in readable for one in owners):
        return
    with suppress(NotFound):  # The check of the options says so.
        library.find(upload_id, store)
        yield Problem(f"/environment/options/{place}", store.kind.missing(upload_id).detail)


def completed(spec: JobSpec) -> JobSpec:
    """The specification with those options of its environment that its algorithm is tuned for.

    They are stored, so that everything that reads the job later sees the environment that it was trained in.
    """
    if not isinstance(spec, TrainSpec):
        return spec
    environment = spec.environment
    if not (taken := environment_options(spec.algorithm, environment.id, environment.options)):
        return spec
    options = {**environment.options, **taken}
    return spec.model_copy(update={"environment": environment.model_copy(update={"options": options})})


def with_environment(spec: JobSpec, store: JobStore) -> JobSpec:
    """The specification; a rollout without an environment gets that of its policy's job. Raises Rejected."""
    if not isinstance(spec, RolloutSpec) or "environment" in spec.model_fields_set:
        return spec
    if not isinstance(spec.policy, CheckpointPolicy):
        detail = "`environment` is missing; only a rollout of a checkpoint may leave it out."
        raise Rejected(detail, [Problem("/environment", detail)])
    source = find(spec.policy.job, store.get, "/policy/job")
    return spec.model_copy(update={"environment": source.spec.environment})


def hand_over_if_room(dispatch: Dispatch, job: Job, queue: JobQueue) -> bool:
    """`hand_over` for a new job; where many wait already, the reconciler does it when their turn has come."""
    name = queue_of(job)
    try:
        if queue.num_waiting([name])[name] >= MOST_SUBMITTED:
            return False
    except RecordsUnavailable as error:
        log.warning("dispatch_postponed", subject=dispatch.subject, error=error.detail)
        return False
    return hand_over(dispatch, queue=queue, job=job)


def hand_over(dispatch: Dispatch, *, queue: JobQueue, job: Job | None = None, again: bool = False) -> bool:
    """Put the dispatch into the workers' queue; returns whether that worked. If not, the reconciler retries.

    job: the job of an attempt. again: as for `JobQueue.enqueue`.
    """
    try:
        if job is None:
            assert dispatch.task != "attempt"  # noqa: S101
            queue.enqueue_upload(dispatch.task, dispatch.subject)
        else:
            queue.enqueue(job.id, job.next_attempt, name=queue_of(job), again=again)
    except RecordsUnavailable as error:
        log.warning("dispatch_postponed", subject=dispatch.subject, error=error.detail)
        return False
    except GaitwayError:
        raise
    except Exception:
        # Such as a refusal by Redis that its adapter does not know. The record has the job: the client must
        # not be told that the submission failed.
        log.exception("dispatch_failed", subject=dispatch.subject)
        return False
    return True


_GATHER_S = 0.1


class Acknowledgements:
    """Gathers dispatches for a tenth of a second and writes them in one call; thread-safe.

    write: `JobStore.dispatched`. A dispatch that a crash or an outage leaves in the record does no harm: the
    reconciler hands it over again, and RQ already knows it.
    """

    def __init__(self, write: Callable[[Sequence[Dispatch]], None]) -> None:
        self._write = write
        self._gathered: list[Dispatch] = []
        self._lock = Lock()
        self._writing = Lock()

    def add(self, dispatch: Dispatch) -> None:
        with self._lock:
            self._gathered.append(dispatch)
            is_first = len(self._gathered) == 1
        if is_first:
            timer = Timer(_GATHER_S, self.flush)
            timer.daemon = True
            timer.start()

    def flush(self) -> None:
        """Write what has been gathered; a write that is under way elsewhere has ended, too."""
        with self._writing:
            with self._lock:
                gathered, self._gathered = self._gathered, []
            self._write_or_drop(gathered)

    def add_at_once(self, dispatch: Dispatch) -> None:
        """Write this one now."""
        self._write_or_drop([dispatch])

    def _write_or_drop(self, dispatches: Sequence[Dispatch]) -> None:
        try:
            self._write(dispatches)
        except RecordsUnavailable as error:
            log.warning("acknowledgements_dropped", number=len(dispatches), error=error.detail)


@dataclass(frozen=True)
class ImportedFile:
    """A file of the run. open: its bytes, which have the artifact's hash."""

    artifact: Artifact
    open: Callable[[], AbstractContextManager[IO[bytes]]]


@dataclass(frozen=True)
class ImportedRun:
    """An ended run under its new id.

    metrics: in the order of their numbers, each for a chunk. events: those after the metrics. log: its lines.
    """

    job: Job
    files: Sequence[ImportedFile]
    metrics: Sequence[Block]
    events: Sequence[Entry]
    log: Iterable[str]


def import_run(
    run: ImportedRun, *, store: JobStore, objects: ObjectStore, idempotency: Idempotency | None = None
) -> Job:
    """Store the run; or return the job that an earlier import with the same key created.

    A run that is refused leaves nothing. Files that cannot be removed, because a process or a store has
    failed, are removed by the sweep of orphans (`core.jobs.orphans`).
    Raises BadExport, IdempotencyKeyReused, RecordsUnavailable, StorageUnavailable.
    """
    try:
        for file in run.files:
            artifact = file.artifact
            with file.open() as stream:
                _put(artifact, stream, objects)
        assert run.job.finished_at is not None  # noqa: S101
        chunks = store_imported(run.job.id, run.metrics, run.log, run.job.finished_at, objects)
        job = _record(run, chunks, store, idempotency)
    except RecordsUnavailable:  # The record may be stored, and only the answer lost.
        raise
    except Exception:
        _remove_files(run, objects)
        raise
    if job is not run.job:
        _remove_files(run, objects)
    return job


def _put(artifact: Artifact, stream: IO[bytes], objects: ObjectStore) -> None:
    try:
        objects.put_stream(artifact.key, stream, artifact.size, media_type=artifact.media_type)
    except Rejected as error:
        raise BadExport(f"The file {artifact.name[:100]!r} cannot be stored: {error.detail}") from error


def _record(
    run: ImportedRun, chunks: Sequence[Chunk], store: JobStore, idempotency: Idempotency | None
) -> Job:
    """The job once it is stored, or the one that another import with this key has stored meanwhile."""
    try:
        while not store.import_job(run.job, chunks, run.events, idempotency=idempotency):
            # None if that job was deleted just now, and its key with it.
            if idempotency is not None and (known := store.remembered(idempotency)) is not None:
                return known
    except JobUnreadable as error:
        raise BadExport(f"The record of the job cannot be stored: {error.problem}.") from error
    return run.job


def _remove_files(run: ImportedRun, objects: ObjectStore) -> None:
    with suppress(StorageUnavailable):
        objects.delete_prefix(keys.job(run.job.id))
