"""Ends uploads of large objects whose process died, once they are a day old."""

from datetime import timedelta

import structlog

from core.errors import StorageUnavailable
from core.jobs.store import JobStore
from core.storage import keys
from core.storage.objects import ObjectStore

log = structlog.get_logger()

# No upload of a process that is alive takes as long.
GRACE = timedelta(hours=24)


def end_unfinished(*, store: JobStore, objects: ObjectStore, grace: timedelta = GRACE) -> int:
    """Remove what such uploads left; returns how many there were. Raises RecordsUnavailable.

    A store that refuses is only logged: the service does not need this, and its key may lack the right.
    """
    before = store.now() - grace
    try:
        ended = sum(objects.end_uploads(prefix, before) for prefix in keys.folders())
    except StorageUnavailable as error:
        log.warning(
            "unfinished_uploads_kept",
            error=error.detail,
            remedy="a lifecycle rule of the bucket with AbortIncompleteMultipartUpload removes them, too",
        )
        return 0
    if ended:
        log.info("unfinished_uploads_ended", num_uploads=ended)
    return ended
