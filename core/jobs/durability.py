"""The durable copy of a job's record, and the way back from it when Redis has lost everything."""

import json
from collections.abc import Iterator
from datetime import datetime, timedelta

import structlog
from pydantic import BaseModel

from core.errors import JobExists, ObjectNotFound, StorageUnavailable
from core.jobs.job import Artifact, Job
from core.jobs.status import JobStatus, Reason
from core.jobs.store import JobQuery, JobStore
from core.storage import keys
from core.storage.objects import ObjectStore

log = structlog.get_logger()

# A submission writes its specification a moment before its record: leave it that moment.
_SETTLING = timedelta(seconds=30)


class Manifest(BaseModel):
    """What readers may see of one attempt. Written after the files that it names."""

    job: str
    attempt: int
    artifacts: list[Artifact] = []


def keep_record(job: Job, objects: ObjectStore) -> bool:
    """Copy the record to the object store; whether it worked. The next copy makes up for a missed one."""
    try:
        objects.put(keys.record(job.id), job.model_dump_json().encode(), media_type="application/json")
    except StorageUnavailable as error:
        log.warning("record_not_copied", job_id=job.id, error=error.detail)
        return False
    return True


def restore(store: JobStore, objects: ObjectStore, now: datetime) -> int:
    """Rebuild an empty store from the bucket; how many jobs came back. One that has jobs is left alone."""
    if store.list(JobQuery(), limit=1).jobs:
        return 0
    restored = 0
    for job in _recorded(objects):
        if now - job.created_at < _SETTLING:
            continue
        try:
            store.add(_queued_again(job, objects, now))
        except JobExists:
            continue
        restored += 1
    if restored:
        log.warning("jobs_restored", num_jobs=restored)
    return restored


def _recorded(objects: ObjectStore) -> Iterator[Job]:
    for info in objects.list("jobs/"):
        if not info.key.endswith("/spec.json"):
            continue
        try:
            body = objects.get(info.key.replace("/spec.json", "/record.json"))
        except ObjectNotFound:
            body = objects.get(info.key)
        yield Job.model_validate_json(body)


def _queued_again(job: Job, objects: ObjectStore, now: datetime) -> Job:
    """A finished job as it was; any other queued, with every artifact that a manifest names."""
    if job.status.is_final:
        return job
    if job.status.is_held:
        held = (
            job
            if job.status != JobStatus.CANCELLING
            else job.model_copy(update={"status": JobStatus.RUNNING})
        )
        job = held.requeued(Reason.WORKER_LOST, "The job records were lost and rebuilt.", now)
    for attempt in job.attempts:
        try:
            manifest = json.loads(objects.get(keys.manifest(job.id, attempt.number)))
        except ObjectNotFound:
            continue
        job = job.with_artifacts(tuple(Manifest.model_validate(manifest).artifacts))
    return job
