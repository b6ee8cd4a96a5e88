"""The models that there are: the object store alone knows them, by the hash of their bytes."""

import hashlib
import re
from collections.abc import Iterator
from datetime import datetime, timedelta
from functools import partial

import structlog
from pydantic import ValidationError

from core.environments.mjcf.archive import examine
from core.errors import BadModel, ModelNotFound, ObjectNotFound
from core.models.queue import ModelQueue
from core.models.record import ModelRecord
from core.storage import keys
from core.storage.objects import ObjectStore

log = structlog.get_logger()

_ID = re.compile(r"sha256:[0-9a-f]{64}")
# How long whoever was answered 202 may ask why the model was refused.
_TOLD_FOR = timedelta(days=1)


def identity(body: bytes) -> str:
    """The id of a model whose file has these bytes."""
    return f"sha256:{hashlib.sha256(body).hexdigest()}"


def find(model_id: str, objects: ObjectStore) -> ModelRecord:
    """Raises ModelNotFound; also for what cannot be an id, so that it never becomes part of a key."""
    if _ID.fullmatch(model_id) is None:
        raise ModelNotFound(model_id[:80])
    try:
        return ModelRecord.model_validate_json(objects.get(keys.model_record(model_id)))
    except ObjectNotFound:
        raise ModelNotFound(model_id) from None


def add(
    body: bytes, media_type: str, *, objects: ObjectStore, queue: ModelQueue, now: datetime
) -> ModelRecord:
    """The record of this file; unless it is known and good, a worker is about to look at it.

    Raises BadModel where it need not even do that.
    """
    model_id = identity(body)
    try:
        known = find(model_id, objects)
    except ModelNotFound:
        known = None
    if known is not None and known.status != "refused":
        return ask_again(known, queue)
    examine(body)
    record = ModelRecord(
        id=model_id, status="validating", media_type=media_type, size=len(body), created_at=now
    )
    objects.put(keys.model_source(model_id), body, media_type=media_type)
    keep(record, objects)
    queue.enqueue_model(model_id)
    return record


def ask_again(record: ModelRecord, queue: ModelQueue) -> ModelRecord:
    """The record; a validation that the queue has lost is asked for once more."""
    if record.status == "validating" and not queue.contains_model(record.id):
        queue.enqueue_model(record.id)
    return record


def keep(record: ModelRecord, objects: ObjectStore) -> None:
    """Store the record, in the place of an earlier one."""
    objects.put(
        keys.model_record(record.id), record.model_dump_json().encode(), media_type="application/json"
    )


def refused(record: ModelRecord, objects: ObjectStore) -> BadModel:
    """The refusal to answer with; nothing is left of the model."""
    objects.delete_prefix(keys.model(record.id))
    return BadModel(record.message or "It cannot be used.")


def tidy(*, objects: ObjectStore, queue: ModelQueue, now: datetime) -> int:
    """Forget refusals that are older than a day; how many. What waits and was lost is queued again.

    A record is read just before it is removed, and a model that is sent again in between is not ready so
    soon: what is lost is at most an upload whose sender still waits, and is told that it is not there.
    """
    forgotten = 0
    for record in every(objects):
        if record.status == "refused" and now - (record.refused_at or record.created_at) > _TOLD_FOR:
            objects.delete_prefix(keys.model(record.id))
            forgotten += 1
        ask_again(record, queue)
    return forgotten


def every(objects: ObjectStore) -> Iterator[ModelRecord]:
    """All there are, by their ids."""
    records = [info.key for info in objects.list(keys.models()) if info.key.endswith("/record.json")]
    yield from filter(None, map(partial(_read, objects), records))


def _read(objects: ObjectStore, key: str) -> ModelRecord | None:
    try:
        return ModelRecord.model_validate_json(objects.get(key))
    except ObjectNotFound:  # Deleted since it was listed.
        return None
    except ValidationError:  # Of another version; the others are to be seen all the same.
        log.warning("model_record_not_understood", key=key)
        return None
