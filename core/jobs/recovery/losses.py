"""Objects that the record names and the bucket has lost."""

from collections.abc import Iterator, Sequence

from core.errors import JobNotFound, JobUnreadable
from core.jobs.job import Artifact, Job
from core.jobs.lost_feeds import close_gap
from core.jobs.recovery.finding import Finding, is_there, sizes_of
from core.jobs.store import Chunk, JobQuery, JobStore
from core.storage import keys
from core.storage.objects import ObjectStore

_PAGE = 200


def losses_of_the_record(store: JobStore, objects: ObjectStore) -> Iterator[Finding]:
    cursor: str | None = None
    while True:
        page = store.list(JobQuery(), cursor=cursor, limit=_PAGE)
        chunks = store.chunks([job.id for job in page.jobs])
        for job in page.jobs:
            named = chunks.get(job.id, ())
            if isinstance(job, Job) and (job.artifacts or named):
                sizes = sizes_of(objects.list(keys.job(job.id)))
                lost = [a for a in job.artifacts if not is_there(a, sizes)]
                gaps = [chunk for chunk in named if sizes.get(chunk.key) != chunk.size]
                if (lost or gaps) and (found := _loss(job.id, lost, gaps, store, objects)) is not None:
                    yield found
        cursor = page.next_cursor
        if cursor is None:
            return


def _loss(
    job_id: str, lost: Sequence[Artifact], gaps: Sequence[Chunk], store: JobStore, objects: ObjectStore
) -> Finding | None:
    """The finding about losses that the record named before the bucket was listed, and still names."""
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
            note = f"Lost from the object store, and removed from the record: {', '.join(names)}."
            store.restore(job.next(artifacts=kept), replaces=job.version, note=note)
        for chunk in gaps:
            close_gap(job_id, chunk, store=store, objects=objects)

    return Finding(f"Job {job_id}: the bucket has lost {', '.join([*names, *parts])}.", "mark", mark)
