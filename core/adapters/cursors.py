"""Cursors, with which readers continue a listing; they come from clients, so they are checked."""

from core.errors import JobNotFound, Problem, Rejected
from core.jobs.job import check_job_id


def check_cursor(cursor: str) -> str:
    """The id of the last job of a page; raises Rejected if the cursor is not a job's id."""
    try:
        return check_job_id(cursor)
    except JobNotFound:
        sentence = "The cursor is not one that this listing gave; leave it out to begin at the newest job."
        raise Rejected(sentence, [Problem("/cursor", sentence)]) from None
