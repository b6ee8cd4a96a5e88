"""The entries that a store itself adds to a feed."""

from core.jobs.job import Job, utc_now
from core.jobs.store import Entry


def status_entry(job: Job) -> Entry:
    """The event for a job's change of status."""
    attempt = job.attempts[-1].number if job.attempts else None
    said = {"status": job.status.value, "reason": job.reason, "message": job.message, "attempt": attempt}
    return Entry(kind="status", time=utc_now(), data=said)
