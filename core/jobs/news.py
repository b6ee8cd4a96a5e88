"""What a job's change of status is news of."""

from typing import Any

from core.jobs.job import Job, utc_now
from core.jobs.status import RETRIED, JobStatus
from core.news.webhook import JobEvent, News, new_message

# A message may be the tail of a log; receivers such as chats take short ones.
_LONGEST_MESSAGE = 1000
_ENDS: dict[JobStatus, JobEvent] = {
    JobStatus.SUCCEEDED: "job.succeeded",
    JobStatus.FAILED: "job.failed",
    JobStatus.CANCELLED: "job.cancelled",
}


def news_of(job: Job, before: JobStatus) -> News | None:
    """The message about a job that had another status before; None where nobody needs to hear of it."""
    event = event_of(job, before)
    if event is None:
        return None
    return new_message(
        event,
        job.finished_at or utc_now(),
        data_of(job),
        project=job.project,
        owner=job.owner,
        job=job.id,
        notify=tuple(job.spec.notify),
    )


def event_of(job: Job, before: JobStatus) -> JobEvent | None:
    """A first attempt starts, an attempt is lost and another one follows, or the job ends."""
    if job.status == before:
        return None
    if job.status == JobStatus.STARTING and len(job.attempts) == 1:
        return "job.started"
    if job.status == JobStatus.QUEUED and job.attempts and job.attempts[-1].reason in RETRIED:
        return "job.attempt_lost"
    return _ENDS.get(job.status)


def data_of(job: Job) -> dict[str, Any]:
    """What the message says of the job, in the words of `GET /jobs/{job_id}`."""
    last = job.attempts[-1] if job.attempts else None
    is_over = job.status.is_final
    reason, message = (job.reason, job.message) if is_over else (last and last.reason, last and last.message)
    return {
        "id": job.id,
        "kind": job.spec.kind,
        "name": job.spec.name,
        "labels": job.spec.labels,
        "environment": job.spec.environment.id,
        "project": job.project,
        "owner": job.owner,
        "status": job.status,
        "reason": reason,
        # PostgreSQL stores no U+0000 as text.
        "message": message and message[:_LONGEST_MESSAGE].replace("\0", "\N{REPLACEMENT CHARACTER}"),
        "attempts": len(job.attempts),
        "created_at": job.created_at,
        "started_at": job.started_at,
        "finished_at": job.finished_at,
        "href": f"/jobs/{job.id}",
    }
