"""What nobody names is removed after a day, and what a database may have forgotten is left alone."""

import tracemalloc
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from types import SimpleNamespace

import pytest
from structlog.testing import capture_logs
from structlog.typing import EventDict

from core.errors import StorageRefuses, StorageUnavailable
from core.jobs import feeds
from core.jobs.orphans import end_unfinished, sweep
from core.jobs.status import JobStatus
from core.jobs.store import JobStore
from core.storage import keys
from core.storage.objects import ObjectInfo
from core.user_models.record import ModelRecord
from tests.in_memory import MemoryObjectStore
from tests.unit.jobs.making import make_job
from tests.unit.jobs.playing import PlayedWorker
from worker import reconciler
from worker.reconciler import Chore, LongChore

NOBODYS = "019aa3c2f0b1-0000000000"


class AgingObjects(MemoryObjectStore):
    """An object store in which each object is as old as `age` says when it is put."""

    def __init__(self) -> None:
        super().__init__(clock=lambda: datetime.now(UTC) - self.age)
        self.age = timedelta(hours=25)

    def keys(self) -> list[str]:
        return [info.key for info in self.list("")]


@pytest.fixture
def objects() -> AgingObjects:
    return AgingObjects()


@pytest.fixture
def worker(jobs: JobStore, objects: AgingObjects) -> PlayedWorker:
    return PlayedWorker(jobs, objects)


def sweep_all(jobs: JobStore, objects: MemoryObjectStore) -> list[EventDict]:
    """A whole round; what it said."""
    with capture_logs() as said:
        for _ in sweep(store=jobs, objects=objects):
            pass
    return said


def test_an_object_that_no_record_names_is_removed_after_a_day(
    jobs: JobStore, objects: AgingObjects, worker: PlayedWorker
) -> None:
    claim = worker.begin(worker.submit())
    worker.say(claim, "logs", "a line")
    kept = worker.checkpoint(claim, 2, keep=1)
    worker.upload(claim, "dropped", b"never published")
    objects.put(f"{keys.job(claim.job_id)}logs/000000000001-0123456789abcdef.jsonl", b"{}")
    worker.succeed(claim)
    while feeds.compact(store=jobs, objects=objects):
        pass
    objects.age = timedelta(hours=23)
    young = worker.upload(claim, "young", b"not published yet")
    chunks = [chunk.key for chunk in jobs.chunks([claim.job_id])[claim.job_id]]
    assert len(chunks) == 2  # of the events, and of the logs
    assert len(objects.keys()) == 6

    said = sweep_all(jobs, objects)

    assert objects.keys() == sorted([kept.key, young.key, *chunks])
    assert said == [{"event": "orphans_removed", "num_objects": 2, "log_level": "info"}]
    assert sweep_all(jobs, objects) == []


def test_objects_of_a_job_that_the_record_does_not_know_are_left_and_counted(
    jobs: JobStore, objects: AgingObjects, worker: PlayedWorker
) -> None:
    worker.run()
    for name in ("a", "b", "c"):
        objects.put(f"jobs/{NOBODYS}/{name}", b"x")
    before = objects.keys()
    [said] = sweep_all(jobs, objects)
    assert objects.keys() == before
    assert (said["event"], said["unknown_jobs"], said["unknown_objects"]) == ("objects_left_alone", 1, 3)


def test_an_object_that_is_put_again_meanwhile_stays(jobs: JobStore) -> None:
    class PutAgain(AgingObjects):
        def list(self, prefix: str) -> Iterator[ObjectInfo]:
            found = list(super().list(prefix))
            self.age = timedelta(0)
            for info in found:
                self.put(info.key, b"again")
            return iter(found)

    objects = PutAgain()
    worker = PlayedWorker(jobs, objects)
    artifact = worker.upload(worker.begin(worker.submit()), "late", b"body")
    assert sweep_all(jobs, objects) == []
    assert objects.get(artifact.key) == b"again"


def test_nothing_of_a_job_at_work_is_removed(
    jobs: JobStore, objects: AgingObjects, worker: PlayedWorker
) -> None:
    # However long it takes: all that is read for it is named.
    claim = worker.begin(worker.submit())
    artifact = worker.checkpoint(claim, 1)
    sweep_all(jobs, objects)
    assert jobs.get(claim.job_id).status == JobStatus.RUNNING
    assert objects.keys() == [artifact.key]


class TestModels:
    def model(self, number: int) -> str:
        return f"sha256:{number:064x}"

    def test_a_model_without_a_record_is_removed_after_a_day(
        self, jobs: JobStore, objects: AgingObjects, worker: PlayedWorker
    ) -> None:
        worker.run()
        known = ModelRecord(
            id=self.model(1), status="ready", media_type="text/xml", size=1, created_at=jobs.now()
        )
        jobs.models.add(known)
        objects.put(keys.model_source(known.id), b"x")
        objects.put(keys.model_source(self.model(2)), b"x")
        objects.age = timedelta(hours=1)
        objects.put(keys.model_source(self.model(3)), b"x")
        sweep_all(jobs, objects)
        left = [info.key for info in objects.list(keys.models())]
        assert left == [keys.model_source(known.id), keys.model_source(self.model(3))]

    @pytest.mark.parametrize("knows_a_job", [True, False])
    def test_a_record_that_may_have_forgotten_models_costs_none(
        self, knows_a_job: bool, jobs: JobStore, objects: AgingObjects, worker: PlayedWorker
    ) -> None:
        # It does not know all jobs of the bucket; or none at all.
        if knows_a_job:
            worker.run()
            objects.put(f"jobs/{NOBODYS}/a", b"x")
        objects.put(keys.model_source(self.model(1)), b"x")
        before = objects.keys()
        sweep_all(jobs, objects)
        assert objects.keys() == before


def test_a_large_bucket_takes_little_memory(jobs: JobStore) -> None:
    num_jobs, per_job = 2500, 20

    class Large(MemoryObjectStore):
        def list(self, prefix: str) -> Iterator[ObjectInfo]:
            num = num_jobs if prefix == keys.jobs() else 0
            return (
                ObjectInfo(f"jobs/{job:012x}-0000000000/{number:040d}", 1)
                for job in range(num)
                for number in range(per_job)
            )

    tracemalloc.start()
    [said] = sweep_all(jobs, Large())
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert said["unknown_objects"] == num_jobs * per_job
    # All 50,000 at once would take more than 500 bytes each: 25 MB.
    assert peak < 4e6


def test_the_batches_of_a_round_are_steps_of_their_own(jobs: JobStore, objects: AgingObjects) -> None:
    for minutes in range(3):
        jobs.add(job := make_job(minutes=minutes))
        for number in range(600):
            objects.put(f"{keys.job(job.id)}attempts/1/{number:016x}/a", b"x")
    steps = sweep(store=jobs, objects=objects)
    next(steps)
    # One object was removed, and the next step is not begun.
    assert len(objects.keys()) == 3 * 600 - 1
    assert len(list(steps)) == 3 * 600 - 1 + 2  # 1200 objects, then 600: two batches


class TestLongChore:
    """A round of minutes, done a little at each look."""

    def test_a_look_ends_before_the_chore_does(self, monkeypatch: pytest.MonkeyPatch) -> None:
        done: list[int] = []
        # A step takes 0.15 s: two of them fill a look.
        monkeypatch.setattr(reconciler, "time", SimpleNamespace(monotonic=lambda: 0.15 * len(done)))

        def steps() -> Iterator[None]:
            for number in range(3):
                done.append(number)
                yield

        chore = LongChore("long", 3600, steps)
        chore.do_if_due()
        assert done == [0, 1]
        chore.do_if_due()
        assert done == [0, 1, 2]
        chore.do_if_due()
        assert done == [0, 1, 2]  # It is due again in an hour.

    def test_an_outage_makes_it_begin_again(self) -> None:
        begun: list[int] = []

        def steps() -> Iterator[None]:
            begun.append(len(begun))
            if len(begun) == 1:
                raise StorageUnavailable("The object store does not answer.")
            yield

        chore = LongChore("long", 3600, steps)
        for _ in range(3):
            with capture_logs():
                chore.do_if_due()
        assert begun == [0, 1]

    def test_a_bug_ends_no_process_and_is_met_again_at_the_next_time(self) -> None:
        begun: list[int] = []

        def fail() -> Iterator[None]:
            begun.append(len(begun))
            raise ValueError("A damaged row.")

        for chore in (LongChore("long", 3600, fail), Chore("short", 3600, fail)):
            begun.clear()
            with capture_logs() as said:
                chore.do_if_due()
                chore.do_if_due()
            assert begun == [0]
            assert [(entry["event"], entry["log_level"]) for entry in said] == [("chore_failed", "error")]


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
    assert end_unfinished(store=job_store, objects=objects) == 10
    assert set(objects.asked) == {"jobs/", "models/", "clips/", "previews/", "caches/"}
    now = job_store.now()
    for before in objects.asked.values():
        assert timedelta(hours=24) <= now - before < timedelta(hours=24, minutes=2)


def test_a_store_that_refuses_is_logged_with_the_remedy(job_store: JobStore) -> None:
    with capture_logs() as logs:
        assert end_unfinished(store=job_store, objects=Uploads(StorageRefuses("It refuses."))) == 0
    [entry] = logs
    assert (entry["event"], entry["error"]) == ("unfinished_uploads_kept", "It refuses.")
    assert "AbortIncompleteMultipartUpload" in entry["remedy"]
