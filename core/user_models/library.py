"""Users' own models: their records, and their files in the object store by the hash of their bytes."""

import re
from contextlib import suppress
from datetime import datetime, timedelta
from pathlib import Path

from core.accounts.principal import ANYONE, NOBODYS, Ownership, Principal
from core.errors import BadModel, ModelNotFound, RecordsUnavailable
from core.storage import keys
from core.storage.objects import ObjectStore, read_whole
from core.user_models.record import ModelQueue, ModelRecord, ModelStore

_ID = re.compile(r"sha256:[0-9a-f]{64}")
# How long a client that was answered 202 may ask why the model was refused.
_REFUSAL_KEPT_FOR = timedelta(days=1)


def find(model_id: str, store: ModelStore) -> ModelRecord:
    """The record. Raises ModelNotFound, also for a malformed id, so that it never becomes part of a key."""
    if _ID.fullmatch(model_id) is None:
        raise ModelNotFound(model_id[:80])
    return store.find_model(model_id)


def source(model_id: str, objects: ObjectStore) -> bytes:
    """The file as it was sent. Raises ObjectNotFound, ObjectDamaged, StorageUnavailable."""
    return read_whole(keys.model_source(model_id), model_id.removeprefix("sha256:"), objects)


def add(  # noqa: PLR0913 # All but the file are named.
    file: Path,
    sha256: str,
    media_type: str,
    *,
    store: ModelStore,
    objects: ObjectStore,
    queue: ModelQueue,
    now: datetime,
    name: str | None = None,
    sender: Principal = ANYONE,
    ownership: Ownership = NOBODYS,
) -> ModelRecord:
    """The record of this file. Unless it is known and good, the file is stored and queued for validation.

    The owner's project has a known model, too. It gets the new name only where all whose it is are the
    sender, or the sender is an admin: there is one name for all projects.
    """
    model_id = f"sha256:{sha256}"
    try:
        known = find(model_id, store)
    except ModelNotFound:
        known = None
    if known is not None and known.status != "refused":
        store.claim_model(model_id, ownership)
        if name in (None, known.name) or not _may_rename(model_id, sender, store):
            return known
        store.name_model(model_id, str(name))
        return known.model_copy(update={"name": name})
    record = ModelRecord(
        id=model_id,
        name=name,
        status="validating",
        media_type=media_type,
        size=file.stat().st_size,
        created_at=now,
    )
    objects.put_file(keys.model_source(model_id), file, media_type=media_type)
    store.add_model(record)
    store.claim_model(model_id, ownership)
    with suppress(RecordsUnavailable):  # The reconciler tells the queue later.
        queue.enqueue_model(model_id)
        store.model_dispatched(model_id)
    return record


def _may_rename(model_id: str, sender: Principal, store: ModelStore) -> bool:
    return all(sender.may_change(one.owner) for one in store.owners_of_models([model_id]).get(model_id, ()))


def forget(model_id: str, *, store: ModelStore, objects: ObjectStore) -> None:
    """Remove the file and the record."""
    objects.delete_prefix(keys.model(model_id))
    store.delete_model(model_id)


def refused(record: ModelRecord, *, store: ModelStore, objects: ObjectStore) -> BadModel:
    """The refusal to answer with; nothing is left of the model."""
    forget(record.id, store=store, objects=objects)
    return BadModel(record.message or "It cannot be used.")


def tidy(*, store: ModelStore, objects: ObjectStore, now: datetime) -> int:
    """Forget refusals that are older than a day; returns how many.

    A record is read just before it is removed. If the model is sent again in between, it is lost while its
    sender still waits for the validation, and the sender is told that it does not exist.
    """
    old = [
        record.id
        for record in store.models()
        if record.status == "refused" and now - (record.refused_at or record.created_at) > _REFUSAL_KEPT_FOR
    ]
    for model_id in old:
        forget(model_id, store=store, objects=objects)
    return len(old)
