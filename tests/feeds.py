"""Feeds as lists."""

from core.jobs import feeds
from core.jobs.store import Channel, Entry, JobStore
from core.storage.objects import ObjectStore


def read_feed(
    job_id: str,
    channel: Channel,
    *,
    store: JobStore,
    objects: ObjectStore,
    after: int = 0,
    limit: int | None = None,
    at_once: int | None = None,
    kind: str | None = None,
) -> list[Entry]:
    """Entries later than number `after`, of one kind where given; at most `limit` of them.

    at_once: how many a read asks for; by default `limit`.
    """
    found = list[Entry]()
    at_once = at_once or limit or feeds.PAGE
    for page in feeds.read_pages(job_id, channel, store=store, objects=objects, after=after, at_once=at_once):
        found += [entry for entry in page if kind in (None, entry.kind)]
        if limit is not None and len(found) >= limit:
            break
    return found[:limit]
