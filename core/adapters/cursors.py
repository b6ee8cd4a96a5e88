"""What readers hand back to go on where they were; it comes from clients, so it is checked."""

from core.errors import JobNotFound, Problem, Rejected
from core.jobs.job import check_job_id


def check_cursor(cursor: str) -> str:
    """The id of the last job of a page; raises Rejected where it is none."""
    try:
        return check_job_id(cursor)
    except JobNotFound:
        sentence = "The cursor is not one that this listing gave; leave it out to begin at the newest job."
        raise Rejected(sentence, [Problem("/cursor", sentence)]) from None
