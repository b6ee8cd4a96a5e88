"""Uploads of dead processes are ended in every folder, and a store that refuses stops nothing."""

from datetime import datetime, timedelta

from structlog.testing import capture_logs

from core.adapters.memory.objects import MemoryObjectStore
from core.errors import StorageRefuses
from core.jobs.orphans import end_unfinished
from core.jobs.store import JobStore


class Uploads(MemoryObjectStore):
    """An object store in which two uploads of each folder are old; it notes what it is asked."""

    def __init__(self, refusal: StorageRefuses | None = None) -> None:
        super().__init__()
        self.asked: dict[str, datetime] = {}
        self._refusal = refusal

    def end_uploads(self, prefix: str, before: datetime) -> int:
        if self._refusal is not None:
            raise self._refusal
        self.asked[prefix] = before
        return 2


def test_all_folders_are_looked_through_for_uploads_of_a_day_ago(job_store: JobStore) -> None:
    objects = Uploads()
    assert end_unfinished(store=job_store, objects=objects) == 8
    assert set(objects.asked) == {"jobs/", "models/", "previews/", "caches/"}
    now = job_store.now()
    for before in objects.asked.values():
        assert timedelta(hours=24) <= now - before < timedelta(hours=24, minutes=2)


def test_a_store_that_refuses_is_logged_with_the_remedy(job_store: JobStore) -> None:
    with capture_logs() as logs:
        assert end_unfinished(store=job_store, objects=Uploads(StorageRefuses("It refuses."))) == 0
    [entry] = logs
    assert (entry["event"], entry["error"]) == ("unfinished_uploads_kept", "It refuses.")
    assert "AbortIncompleteMultipartUpload" in entry["remedy"]
