"""A copy of each record beside its objects, in case the database is lost.

The reconciler writes it shortly after each change. `gaitway recover` reads it to adopt what a restored
database does not know, and the sweep of orphans reads it to leave that alone. Nothing else reads it.
"""

import json
from typing import Any

from core.errors import JobUnreadable, ObjectDamaged, ObjectNotFound
from core.jobs.job import Job
from core.jobs.store import JobStore
from core.jobs.stored_spec import read_spec
from core.storage import keys
from core.storage.objects import ObjectStore

_AT_ONCE = 50


def copy_records(*, store: JobStore, objects: ObjectStore) -> int:
    """Copy the records that have changed; returns how many were checked.

    An unreadable record keeps its present copy. So does one that is older than its copy: the database was
    restored, and `gaitway recover` has not run yet. Raises RecordsUnavailable, StorageUnavailable; the rest
    is copied the next time.
    """
    changed = store.uncopied(limit=_AT_ONCE)
    for job in changed:
        if isinstance(job, Job) and not _is_behind(job, objects):
            copy_record(job, objects)
        if not store.copied(job.id, job.version):  # Deleted meanwhile, and perhaps before the copy was there.
            objects.delete_prefix(keys.record(job.id))
    return len(changed)


def copy_record(job: Job, objects: ObjectStore) -> None:
    """Write the copy. Raises StorageUnavailable."""
    objects.put(keys.record(job.id), job.model_dump_json().encode(), media_type="application/json")


def _is_behind(job: Job, objects: ObjectStore) -> bool:
    try:
        copy = read_copy(job.id, objects)
    except JobUnreadable:
        return False
    return copy is not None and copy.version > job.version


def read_copy(job_id: str, objects: ObjectStore) -> Job | None:
    """The job as it was when it was last copied; None where there is no copy.

    Raises JobUnreadable, StorageUnavailable.
    """
    try:
        text = objects.get(keys.record(job_id))
    except ObjectDamaged as error:
        raise JobUnreadable(job_id, f"its copy in the object store is damaged ({error.why})") from error
    except ObjectNotFound:
        return None
    try:
        document: dict[str, Any] = json.loads(text)
        job = Job.model_validate({**document, "spec": read_spec(json.dumps(document["spec"]))})
    except (ValueError, KeyError, TypeError) as error:  # JSON's and pydantic's errors are ValueErrors.
        raise JobUnreadable(
            job_id, f"its copy in the object store is of another version ({error})"
        ) from error
    if job.id != job_id:
        raise JobUnreadable(job_id, f"its copy in the object store is that of job {job.id}")
    return job
