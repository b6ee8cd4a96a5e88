"""A copy of each record beside its objects, for the day on which the database is lost.

`gaitway recover` reads it, to adopt what a restored database does not know; and the sweep of orphans, to
leave that alone. Nothing else does.
"""

import json
from typing import Any

import structlog

from core.errors import JobUnreadable, ObjectNotFound, StorageUnavailable
from core.jobs.job import Job
from core.jobs.stored_spec import read_spec
from core.storage import keys
from core.storage.objects import ObjectStore

log = structlog.get_logger()


def copy_record(job: Job, objects: ObjectStore) -> None:
    """Write the copy. A store that is away is no failure: the next copy makes up for a missed one."""
    try:
        objects.put(keys.record(job.id), job.model_dump_json().encode(), media_type="application/json")
    except StorageUnavailable as error:
        log.warning("record_not_copied", job_id=job.id, error=error.detail)


def read_copy(job_id: str, objects: ObjectStore) -> Job | None:
    """The job as it was when it was copied last; None where there is no copy.

    Raises JobUnreadable, StorageUnavailable.
    """
    try:
        text = objects.get(keys.record(job_id))
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
