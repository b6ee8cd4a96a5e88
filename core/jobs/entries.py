"""Entries of a feed that no attempt has written."""

from datetime import datetime

from core.jobs.job import Job, utc_now
from core.jobs.store import Entry


def status_entry(job: Job, time: datetime | None = None) -> Entry:
    """The event for a job's change of status; by default it has just changed."""
    attempt = job.attempts[-1].number if job.attempts else None
    said = {"status": job.status.value, "reason": job.reason, "message": job.message, "attempt": attempt}
    return Entry(kind="status", time=time or utc_now(), data=said)


def note_entry(text: str) -> Entry:
    """An event for people."""
    return Entry(kind="note", time=utc_now(), data={"text": text})
