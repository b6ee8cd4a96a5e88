"""The objective's values of running trials, read from their events; only what came since is read again."""

from dataclasses import dataclass, field

from core.errors import JobNotFound
from core.jobs import feeds
from core.jobs.store import JobStore
from core.storage.objects import ObjectStore
from core.sweeps.sweep import Curve


@dataclass
class _Known:
    """last: the number of the last entry that was read. is_whole: the job had ended before that."""

    last: int = 0
    is_whole: bool = False
    values: dict[int, float] = field(default_factory=dict[int, float])


class Curves:
    """A cache over the feeds: a process without it reads them from the beginning and finds the same."""

    def __init__(self, store: JobStore, objects: ObjectStore) -> None:
        self._store = store
        self._objects = objects
        self._known: dict[tuple[str, str], _Known] = {}

    def read(self, job_id: str | None, metric: str, *, has_ended: bool) -> Curve:
        """The values by step; empty for a job that is gone. Raises the errors of `feeds.read_page`."""
        if job_id is None:
            return {}
        known = self._known.setdefault((job_id, metric), _Known())
        if known.is_whole:
            return known.values
        try:
            self._read_on(job_id, metric, known)
        except JobNotFound:
            self._known.pop((job_id, metric))
            return {}
        known.is_whole = has_ended
        return dict(known.values)

    def _read_on(self, job_id: str, metric: str, known: _Known) -> None:
        pages = feeds.read_pages(job_id, "events", store=self._store, objects=self._objects, after=known.last)
        for page in pages:
            for entry in page:
                if entry.kind == "metrics" and isinstance(
                    value := entry.data["values"].get(metric), float | int
                ):
                    # An attempt that resumed at a checkpoint reports steps again; the newest value counts.
                    known.values[int(entry.data["step"])] = float(value)
            if page:
                known.last = int(page[-1].id)
