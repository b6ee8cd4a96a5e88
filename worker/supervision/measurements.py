"""The measurements of a job, over all of its attempts."""

import json

from core.jobs import feeds
from core.jobs.store import Entry, JobStore
from core.storage.objects import ObjectStore


class Measurements:
    """Rows of step, time and values; a later row for the same step takes the place of an earlier one."""

    def __init__(self, job_id: str, store: JobStore, objects: ObjectStore) -> None:
        self._job_id = job_id
        self._store = store
        self._objects = objects
        self._rows: dict[tuple[int, tuple[str, ...]], Entry] | None = None

    def add(self, entry: Entry) -> None:
        """Take a row that the feed holds already."""
        if self._rows is not None:
            self._rows[_identity(entry)] = entry

    def documents(self) -> list[str]:
        """Each row as JSON. Reads the feed once. Raises RecordsUnavailable, StorageUnavailable."""
        if self._rows is None:
            found = feeds.read(
                self._job_id,
                "events",
                store=self._store,
                objects=self._objects,
                kind="metrics",
                limit=1_000_000,
            )
            self._rows = {_identity(entry): entry for entry in found}
        rows = self._rows.values()
        return [json.dumps({"time": row.time.isoformat(), **row.data}, sort_keys=True) for row in rows]


def _identity(entry: Entry) -> tuple[int, tuple[str, ...]]:
    return (entry.data["step"], tuple(sorted(entry.data["values"])))
