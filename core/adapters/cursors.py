"""Cursors, with which readers continue a listing; they come from clients, so they are checked."""

import re
from datetime import UTC, datetime, timedelta

from core.errors import JobNotFound, Problem, Rejected
from core.jobs.job import check_job_id
from core.jobs.workers import WORKER_NAME
from core.user_models.record import ModelRecord

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_MODEL = re.compile(r"([0-9]{1,17})-(sha256:[0-9a-f]{64})")


def check_cursor(cursor: str) -> str:
    """The id of the last job of a page; raises Rejected if the cursor is not a job's id."""
    try:
        return check_job_id(cursor)
    except JobNotFound:
        raise _refusal() from None


def model_cursor(record: ModelRecord) -> str:
    """When the last model of a page was sent, in microseconds since 1970, and its id."""
    return f"{(record.created_at - _EPOCH) // timedelta(microseconds=1)}-{record.id}"


def check_model_cursor(cursor: str) -> tuple[datetime, str]:
    """The moment and the id of a cursor made by `model_cursor`. Raises Rejected."""
    found = _MODEL.fullmatch(cursor)
    if found is None:
        raise _refusal()
    return _EPOCH + timedelta(microseconds=int(found[1])), found[2]


def check_worker_cursor(cursor: str) -> str:
    """The name of the last worker of a page; raises Rejected if no worker can have this name."""
    if re.fullmatch(WORKER_NAME, cursor) is None:
        raise _refusal()
    return cursor


def _refusal() -> Rejected:
    sentence = "The cursor is not one that this listing gave; leave it out to begin with the first page."
    return Rejected(sentence, [Problem("/cursor", sentence)])
