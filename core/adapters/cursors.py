"""What readers hand back to go on where they were; it comes from clients, so it is checked."""

import re

from core.errors import JobNotFound, Problem, Rejected
from core.jobs.job import check_job_id

_ENTRY_ID = re.compile(r"(\d{1,19})-(\d{1,19})")


def check_cursor(cursor: str) -> str:
    """The id of the last job of a page; raises Rejected where it is none."""
    try:
        return check_job_id(cursor)
    except JobNotFound:
        sentence = "The cursor is not one that this listing gave; leave it out to begin at the newest job."
        raise Rejected(sentence, [Problem("/cursor", sentence)]) from None


def entry_position(entry_id: str) -> tuple[int, int]:
    """An entry's place in its feed; (0, 0), before every entry, for "". Raises Rejected."""
    if not entry_id:
        return (0, 0)
    found = _ENTRY_ID.fullmatch(entry_id)
    if found is None:
        sentence = f"{entry_id[:64]!r} is not the id of an entry of this feed."
        raise Rejected(sentence, [Problem("/after", sentence)])
    return (int(found[1]), int(found[2]))
