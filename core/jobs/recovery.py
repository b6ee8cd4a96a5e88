"""The record and the bucket, compared after a disaster and brought together again. For `gaitway recover`.

Either may have been restored to an older moment, or lost. What one of them still has is taken over; what
both have lost is marked as lost, so that nobody waits for it.
"""

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from typing import Literal

from core.errors import JobNotFound, JobUnreadable, ModelNotFound
from core.jobs.job import Artifact, Job
from core.jobs.lost_feeds import chunks_beyond, close_gap
from core.jobs.orphans import batches, folders
from core.jobs.record_copy import read_copy
from core.jobs.status import JobStatus, Reason
from core.jobs.store import Chunk, JobQuery, JobStore
from core.storage import keys
from core.storage.objects import ObjectInfo, ObjectStore
from core.user_models.record import ModelRecord

Remedy = Literal["adopt", "mark"]
Sizes = Mapping[str, int]

_PAGE = 200
_OLDER = "The database was restored to an older moment: `gaitway recover`"


def _do_nothing() -> None:
    pass


@dataclass(frozen=True)
class Finding:
    """Something that the record and the bucket do not agree on.

    remedy: what has to be asked for before anything is done; None where nothing can be.
    act: does it; raises NotFound or Conflict where somebody else has changed it meanwhile.
    """

    sentence: str
    remedy: Remedy | None = None
    act: Callable[[], None] = _do_nothing


def findings(*, store: JobStore, objects: ObjectStore) -> Iterator[Finding]:
    """All there are. Act on each before the next is asked for, or on none: later ones follow from earlier.

    Beside a service at work nothing is found that is only on its way.
    """
    yield from _models(store, objects)
    yield from _jobs_of_the_bucket(store, objects)
    yield from _losses_of_the_record(store, objects)


# ---- what the bucket has, and the record does not ------------------------------------------------


def _jobs_of_the_bucket(store: JobStore, objects: ObjectStore) -> Iterator[Finding]:
    num_nameless = 0
    for batch in batches(folders(objects.list(keys.jobs()))):
        known = store.marks(batch)
        for job_id, infos in batch.items():
            sizes = _sizes(infos)
            if job_id not in known and keys.version_01_spec(job_id) in sizes:
                yield Finding(f"Job {job_id} is of version 0.1: `gaitway import` brings it into the record.")
            elif keys.record(job_id) not in sizes:
                num_nameless += job_id not in known
            elif (found := _job(job_id, sizes, job_id in known, store, objects)) is not None:
                yield found
    if num_nameless:
        yield Finding(
            f"The bucket has objects of jobs that the record does not know; {num_nameless} such jobs have no "
            "copy of their record, and nothing can be done about these."
        )


def _job(job_id: str, sizes: Sizes, is_known: bool, store: JobStore, objects: ObjectStore) -> Finding | None:
    """The copy is read before the record: in a service at work it is never the newer of the two."""
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
    whole = [artifact for artifact in copy.artifacts if _is_there(artifact, sizes)]
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
        else:  # It has ended, or has had other attempts since: that stays.
            job = record.with_artifacts(taken).model_copy(update={"version": copy.version + 1})
            store.restore(job, replaces=record.version, note=f"{_OLDER} took over files from its copy.")

    return Finding(sentence, "adopt", adopt)


def _checkpoints_beyond(
    copy: Job, record: Job, sizes: Sizes, store: JobStore, objects: ObjectStore
) -> Finding | None:
    """Of an older copy, the checkpoints that go further than any that the record has and the bucket, too."""
    own = [a.step or 0 for a in record.artifacts if a.role == "checkpoint" and _is_there(a, sizes)]
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
    """Artifacts that are there and that the record lacks, or has lost."""
    own = {artifact.name for artifact in record.artifacts if _is_there(artifact, sizes)}
    return tuple(a for a in copied if a.name not in own and _is_there(a, sizes))


def _merged(copy: Job, record: Job, taken: Sequence[Artifact], sizes: Sizes) -> Job:
    """The later state of the same job, with every file that is there."""
    copied = {artifact.name for artifact in copy.artifacts}
    # What the copy does not name was dropped later. What both name and neither has is lost: it is told below.
    kept = [a for a in record.artifacts if _is_there(a, sizes) or a.name in copied]
    newer = [a for a in copy.artifacts if _is_there(a, sizes)]
    named = {artifact.name: artifact for artifact in (*kept, *taken, *newer)}
    is_cancelled = record.status == JobStatus.CANCELLING and not copy.status.is_final
    status = JobStatus.CANCELLING if is_cancelled else copy.status
    return copy.model_copy(update={"artifacts": tuple(named.values()), "status": status})


def _resumable(job: Job, now: datetime, held_as: str = "") -> Job:
    """The job as another attempt can take it up, unless it has ended.

    held_as: the token of the attempt that holds it in the record; that one's lease decides.
    """
    if not job.status.is_held or job.token == held_as:
        return job
    message = "The database was restored to a moment before the end of this attempt."
    if job.status == JobStatus.CANCELLING:
        return job.ended(JobStatus.CANCELLED, Reason.USER_CANCELLED, f"Cancelled. {message}", now)
    return job.requeued(Reason.WORKER_LOST, message, now)


def _tokens(job: Job) -> Sequence[str]:
    return [attempt.token for attempt in job.attempts]


# ---- what the record names, and the bucket has lost ----------------------------------------------


def _losses_of_the_record(store: JobStore, objects: ObjectStore) -> Iterator[Finding]:
    cursor: str | None = None
    while True:
        page = store.list(JobQuery(), cursor=cursor, limit=_PAGE)
        chunks = store.chunks([job.id for job in page.jobs])
        for job in page.jobs:
            named = chunks.get(job.id, ())
            if isinstance(job, Job) and (job.artifacts or named):
                sizes = _sizes(objects.list(keys.job(job.id)))
                lost = [a for a in job.artifacts if not _is_there(a, sizes)]
                gaps = [chunk for chunk in named if sizes.get(chunk.key) != chunk.size]
                if (lost or gaps) and (found := _loss(job.id, lost, gaps, store, objects)) is not None:
                    yield found
        cursor = page.next_cursor
        if cursor is None:
            return


def _loss(
    job_id: str, lost: Sequence[Artifact], gaps: Sequence[Chunk], store: JobStore, objects: ObjectStore
) -> Finding | None:
    """Of what the record named before the bucket was listed, and still names."""
    try:
        job = store.get(job_id)
    except (JobNotFound, JobUnreadable):
        return None
    lost = [artifact for artifact in lost if artifact in job.artifacts]
    names = [artifact.name for artifact in lost]
    parts = [f"{chunk.channel} {chunk.first} to {chunk.last}" for chunk in gaps]
    if not names and not parts:
        return None

    def mark() -> None:
        if lost:
            kept = tuple(artifact for artifact in job.artifacts if artifact not in lost)
            note = f"Lost from the object store, and struck from the record: {', '.join(names)}."
            store.restore(job.next(artifacts=kept), replaces=job.version, note=note)
        for chunk in gaps:
            close_gap(job_id, chunk, store=store, objects=objects)

    return Finding(f"Job {job_id}: the bucket has lost {', '.join([*names, *parts])}.", "mark", mark)


# ---- users' own models ---------------------------------------------------------------------------


def _models(store: JobStore, objects: ObjectStore) -> Iterator[Finding]:
    known = {record.id for record in store.models() if record.status != "refused"}
    for name, infos in folders(objects.list(keys.models())):
        model_id = f"sha256:{name}"
        if keys.model_source(model_id) not in _sizes(infos):
            continue
        known.discard(model_id)
        if not _is_known(model_id, store):
            sentence = f"Model {model_id}: not in the record. A worker has to validate it again."
            yield Finding(sentence, "adopt", partial(_adopt_model, model_id, store, objects))
    for model_id in sorted(known):
        if _is_known(model_id, store):  # And was not deleted meanwhile.
            sentence = f"Model {model_id}: the bucket has lost its file. It has to be sent again."
            yield Finding(sentence, "mark", partial(store.delete_model, model_id))


def _is_known(model_id: str, store: JobStore) -> bool:
    try:
        store.find_model(model_id)
    except ModelNotFound:
        return False
    return True


def _adopt_model(model_id: str, store: JobStore, objects: ObjectStore) -> None:
    source = objects.info(keys.model_source(model_id))
    store.add_model(
        ModelRecord(
            id=model_id,
            status="validating",
            media_type=source.media_type,
            size=source.size,
            created_at=source.modified_at or store.now(),
        )
    )


# ---- objects -------------------------------------------------------------------------------------


def _sizes(infos: Iterator[ObjectInfo] | Sequence[ObjectInfo]) -> Sizes:
    return {info.key: info.size for info in infos}


def _is_there(artifact: Artifact, sizes: Sizes) -> bool:
    return sizes.get(artifact.key) == artifact.size


def _is_whole(artifact: Artifact, objects: ObjectStore) -> bool:
    """Whether its bytes are those that the record named; one that was struck for damage is not."""
    digest = hashlib.sha256()
    with objects.open(artifact.key) as pieces:
        for piece in pieces:
            digest.update(piece)
    return digest.hexdigest() == artifact.sha256
