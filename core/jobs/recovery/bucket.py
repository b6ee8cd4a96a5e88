"""Jobs and feeds that the bucket has and the record does not."""

from collections.abc import Iterator, Sequence
from datetime import datetime
from functools import partial

from core.errors import JobNotFound, JobUnreadable, ObjectNotFound
from core.jobs.job import Artifact, Job
from core.jobs.lost_feeds import chunks_beyond
from core.jobs.orphans import batches, folders
from core.jobs.record_copy import read_copy
from core.jobs.recovery.finding import Finding, Sizes, is_there, sizes_of
from core.jobs.status import JobStatus
from core.jobs.store import JobStore
from core.reasons import Reason
from core.storage import keys
from core.storage.objects import ObjectStore
from core.storage.whole import check_whole

_OLDER = "The database was restored to an older moment: `gaitway recover`"


def jobs_of_the_bucket(store: JobStore, objects: ObjectStore) -> Iterator[Finding]:
    num_nameless, deleted = 0, set(store.deletions())
    for batch in batches(folders(objects.list(keys.jobs()))):
        known = store.marks(batch)
        for job_id, infos in batch.items():
            if job_id in deleted:  # The reconciler removes the rest of it.
                continue
            sizes = sizes_of(infos)
            if keys.record(job_id) not in sizes:
                num_nameless += job_id not in known
            elif (found := _job(job_id, sizes, job_id in known, store, objects)) is not None:
                yield found
    if num_nameless:
        yield Finding(
            f"The bucket has objects of jobs that the record does not know; {num_nameless} such jobs have no "
            "copy of their record, and nothing can be done about these."
        )


def _job(job_id: str, sizes: Sizes, is_known: bool, store: JobStore, objects: ObjectStore) -> Finding | None:
    """The copy is read before the record, so that in a running service it is never the newer of the two."""
    try:
        copy = read_copy(job_id, objects)
        record = store.get(job_id) if is_known else None
    except JobNotFound:  # Deleted meanwhile.
        return None
    except JobUnreadable as error:
        return None if is_known else Finding(error.detail, "adopt", partial(_refuse, error))
    if copy is None:
        return None
    if record is None:
        return _forgotten(copy, sizes, store, objects)
    if copy.version > record.version:
        return _behind(copy, record, sizes, store, objects)
    return _checkpoints_beyond(copy, record, sizes, store, objects)


def _refuse(error: JobUnreadable) -> None:
    raise error


def _forgotten(copy: Job, sizes: Sizes, store: JobStore, objects: ObjectStore) -> Finding:
    """A job that the record does not know."""
    whole = [artifact for artifact in copy.artifacts if is_there(artifact, sizes)]
    if copy.status.is_final and copy.artifacts and len(sizes) == 1:
        return Finding(f"Job {copy.id}: the bucket has a copy of its record, and none of its files.")
    files = f"{len(whole)} of its {len(copy.artifacts)} files"

    def adopt() -> None:
        job = _resumable(copy.model_copy(update={"artifacts": tuple(whole)}), store.now())
        note = f"Adopted by `gaitway recover` from the copy of its record, with {files}."
        store.restore(
            job, replaces=None, note=note, chunks=chunks_beyond(job.id, sizes, store=store, objects=objects)
        )

    return Finding(
        f"Job {copy.id}: not in the record. The bucket has it as {copy.status}, with {files}.", "adopt", adopt
    )


def _behind(copy: Job, record: Job, sizes: Sizes, store: JobStore, objects: ObjectStore) -> Finding:
    """A job whose record is older than its copy."""
    taken = _new_to(record, copy.artifacts, sizes)
    continues = not record.status.is_final and _tokens(copy)[: len(record.attempts)] == _tokens(record)
    sentence = (
        f"Job {copy.id}: the record is older than its copy in the bucket (version {record.version}, "
        f"{record.status}; the copy has {copy.version}, {copy.status}). Files to take over: {len(taken)}."
    )

    def adopt() -> None:
        if continues:
            job = _resumable(_merged(copy, record, taken, sizes), store.now(), held_as=record.token)
            chunks = chunks_beyond(job.id, sizes, store=store, objects=objects)
            store.restore(
                job,
                replaces=record.version,
                note=f"{_OLDER} took over its copy from the bucket.",
                chunks=chunks,
            )
        else:  # The job has ended, or has had other attempts since: the record stays.
            job = record.with_artifacts(taken).model_copy(update={"version": copy.version + 1})
            store.restore(job, replaces=record.version, note=f"{_OLDER} took over files from its copy.")

    return Finding(sentence, "adopt", adopt)


def _checkpoints_beyond(
    copy: Job, record: Job, sizes: Sizes, store: JobStore, objects: ObjectStore
) -> Finding | None:
    """Checkpoints of an older copy that are newer than any that the record names and the bucket has."""
    own = [a.step or 0 for a in record.artifacts if a.role == "checkpoint" and is_there(a, sizes)]
    newest = max(own, default=-1)
    beyond = [
        artifact
        for artifact in _new_to(record, copy.artifacts, sizes)
        if artifact.role == "checkpoint" and (artifact.step or 0) > newest and _is_whole(artifact, objects)
    ]
    if not beyond:
        return None
    names = ", ".join(artifact.name for artifact in beyond)

    def adopt() -> None:
        note = f"`gaitway recover` took over {names} from an older copy of the record."
        store.restore(record.with_artifacts(tuple(beyond)), replaces=record.version, note=note)

    return Finding(f"Job {copy.id}: an older copy of its record has {names}.", "adopt", adopt)


def _new_to(record: Job, copied: Sequence[Artifact], sizes: Sizes) -> tuple[Artifact, ...]:
    """Copied artifacts that are in the bucket, and that the record lacks or has lost."""
    own = {artifact.name for artifact in record.artifacts if is_there(artifact, sizes)}
    return tuple(a for a in copied if a.name not in own and is_there(a, sizes))


def _merged(copy: Job, record: Job, taken: Sequence[Artifact], sizes: Sizes) -> Job:
    """The later state of the same job, with every file that is there."""
    copied = {artifact.name for artifact in copy.artifacts}
    # What the copy does not name was dropped later. What both name and the bucket lacks is a later finding.
    kept = [a for a in record.artifacts if is_there(a, sizes) or a.name in copied]
    newer = [a for a in copy.artifacts if is_there(a, sizes)]
    named = {artifact.name: artifact for artifact in (*kept, *taken, *newer)}
    is_cancelled = record.status == JobStatus.CANCELLING and not copy.status.is_final
    status = JobStatus.CANCELLING if is_cancelled else copy.status
    return copy.model_copy(update={"artifacts": tuple(named.values()), "status": status})


def _resumable(job: Job, now: datetime, held_as: str = "") -> Job:
    """The job in a state in which another attempt can resume it, unless it has ended.

    held_as: the token of the attempt that holds it in the record; such a job stays as it is, until its lease
    decides.
    """
    if not job.status.is_held or job.token == held_as:
        return job
    message = "The database was restored to a moment before the end of this attempt."
    if job.status == JobStatus.CANCELLING:
        return job.ended(JobStatus.CANCELLED, Reason.USER_CANCELLED, f"Cancelled. {message}", now)
    return job.requeued(Reason.WORKER_LOST, message, now)


def _tokens(job: Job) -> Sequence[str]:
    return [attempt.token for attempt in job.attempts]


def _is_whole(artifact: Artifact, objects: ObjectStore) -> bool:
    """Whether its bytes have the recorded hash; those of a file that was removed for damage do not."""
    try:
        check_whole(artifact.key, artifact.sha256, objects)
    except ObjectNotFound:
        return False
    return True
