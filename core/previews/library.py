"""Stored stills, kept for later requests up to a total size."""

import hashlib
from collections.abc import Sequence
from contextlib import suppress
from datetime import datetime
from itertools import groupby

from core.errors import ObjectNotFound, TooManyPreviews
from core.previews.record import Preview, PreviewQueue, PreviewRequest, Still
from core.rendering.request import RenderFailure
from core.storage import keys
from core.storage.objects import ObjectInfo, ObjectStore

# Any client could fill the queue, and previews come before jobs.
_MAX_WAITING = 16
_MAX_BYTES = 2**28


def find(request: PreviewRequest, objects: ObjectStore) -> Preview | None:
    """The newest preview for an equal request; None where none is kept."""
    found = [info.key for info in objects.list(keys.preview(request.subject, request.id))]
    for key in reversed([key for key in found if key.endswith(keys.PREVIEW_RECORD)]):
        with suppress(ObjectNotFound):  # Removed meanwhile, to make room.
            return Preview.model_validate_json(objects.get(key))
    return None


def ask(request: PreviewRequest, queue: PreviewQueue) -> None:
    """Queue the request, unless it waits already. Raises TooManyPreviews."""
    if queue.contains_preview(request.id):
        return
    if (waiting := queue.num_previews()) >= _MAX_WAITING:
        raise TooManyPreviews(waiting)
    queue.enqueue_preview(request)


def keep(request: PreviewRequest, pictures: Sequence[bytes], objects: ObjectStore, now: datetime) -> None:
    """Store the PNGs, one for each of the request's cameras. The record comes last: it makes them visible."""
    folder = keys.preview_of(request.subject, request.id, now)
    stills: list[Still] = []
    for number, (camera, body) in enumerate(zip(request.cameras, pictures, strict=True)):
        key = f"{folder}still-{number}.png"
        objects.put(key, body, media_type="image/png")
        digest = hashlib.sha256(body).hexdigest()
        stills.append(Still(camera=camera, key=key, size=len(body), sha256=digest))
    _record(Preview(stills=stills), folder, objects)
    keep_within(_MAX_BYTES, objects)


def keep_failure(
    request: PreviewRequest, failure: RenderFailure, objects: ObjectStore, now: datetime
) -> None:
    """Store why there are no stills, for the requests that wait for them."""
    _record(Preview(failure=failure), keys.preview_of(request.subject, request.id, now), objects)


def forget(request: PreviewRequest, objects: ObjectStore) -> None:
    """Remove what is kept for this request, so that it is rendered again."""
    objects.delete_prefix(keys.preview(request.subject, request.id))


def keep_within(max_bytes: int, objects: ObjectStore) -> None:
    """Remove the oldest previews until the rest has no more than `max_bytes`."""
    found = list(objects.list(keys.previews()))
    excess = sum(info.size for info in found) - max_bytes
    whole = [(folder, sum(info.size for info in files)) for folder, files in groupby(found, _folder)]
    for folder, size in sorted(whole, key=lambda one: keys.when_drawn(one[0])):
        if excess <= 0:
            return
        objects.delete_prefix(folder)
        excess -= size


def _record(preview: Preview, folder: str, objects: ObjectStore) -> None:
    body = preview.model_dump_json().encode()
    objects.put(folder + keys.PREVIEW_RECORD, body, media_type="application/json")


def _folder(info: ObjectInfo) -> str:
    return info.key.rpartition("/")[0] + "/"
