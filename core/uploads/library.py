"""What is done with uploads of any kind: their records, and their files in the object store."""

import re
from contextlib import suppress
from datetime import datetime, timedelta
from pathlib import Path

from core.accounts.principal import ANYONE, NOBODYS, Ownership, Principal
from core.errors import NotFound, RecordsUnavailable, Rejected
from core.storage.objects import ObjectStore, read_whole
from core.uploads.record import Record, UploadKind, UploadQueue, UploadStore

_ID = re.compile(r"sha256:[0-9a-f]{64}")
# How long a client that was answered 202 may ask why the file was refused.
_REFUSAL_KEPT_FOR = timedelta(days=1)


def find(upload_id: str, store: UploadStore[Record]) -> Record:
    """The record. Raises the kind's `missing`, also for a malformed id, so that it never becomes part of a
    key."""
    if _ID.fullmatch(upload_id) is None:
        raise store.kind.missing(upload_id[:80])
    return store.find(upload_id)


def source(record: Record, kind: UploadKind[Record], objects: ObjectStore) -> bytes:
    """The file as it was sent. Raises ObjectNotFound, ObjectDamaged, StorageUnavailable."""
    return read_whole(kind.source(record.id), record.file_sha256, objects)


def add(  # noqa: PLR0913 # All but the file are named.
    file: Path,
    record: Record,
    *,
    store: UploadStore[Record],
    objects: ObjectStore,
    queue: UploadQueue,
    sender: Principal = ANYONE,
    ownership: Ownership = NOBODYS,
) -> Record:
    """The record of this file. Unless it is known and good, the file is stored and queued for validation.

    record: of a file that nobody has sent before. The owner's project has a known one, too. That gets the new
    name only where all whose it is are the sender, or the sender is an admin: there is one name for all
    projects.
    """
    try:
        known = find(record.id, store)
    except NotFound:
        known = None
    if known is not None and known.status != "refused" and _claimed(record.id, store, ownership):
        if record.name in (None, known.name) or not may_rename(record.id, sender, store):
            return known
        store.rename(record.id, str(record.name))
        return known.model_copy(update={"name": record.name})
    objects.put_file(store.kind.source(record.id), file, media_type=record.media_type)
    store.add(record)
    store.claim(record.id, ownership)
    with suppress(RecordsUnavailable):  # The reconciler tells the queue later.
        queue.enqueue_upload(store.kind.name, record.id)
        store.dispatched(record.id)
    return record


def _claimed(upload_id: str, store: UploadStore[Record], ownership: Ownership) -> bool:
    """Whether the owner's project has it now; False if somebody has deleted it."""
    try:
        store.claim(upload_id, ownership)
    except NotFound:
        return False
    return True


def may_rename(upload_id: str, sender: Principal, store: UploadStore[Record]) -> bool:
    """Whether it is the sender's in all projects, or the sender is an admin."""
    return all(sender.may_change(one.owner) for one in store.owners_of([upload_id]).get(upload_id, ()))


def forget(upload_id: str, *, store: UploadStore[Record], objects: ObjectStore) -> None:
    """Remove the file, what was made of it, and the record."""
    objects.delete_prefix(store.kind.prefix(upload_id))
    store.delete(upload_id)


def refused(record: Record, *, store: UploadStore[Record], objects: ObjectStore) -> Rejected:
    """The refusal to answer with; nothing is left of the upload."""
    forget(record.id, store=store, objects=objects)
    return store.kind.unusable(record.message or "It cannot be used.")


def tidy(*, store: UploadStore[Record], objects: ObjectStore, now: datetime) -> int:
    """Forget refusals that are older than a day; returns how many.

    A record is read just before it is removed. If the file is sent again in between, it is lost while its
    sender still waits for the validation, and the sender is told that it does not exist.
    """
    old = [
        record.id
        for record in store.all()
        if record.status == "refused" and now - (record.refused_at or record.created_at) > _REFUSAL_KEPT_FOR
    ]
    for upload_id in old:
        forget(upload_id, store=store, objects=objects)
    return len(old)
