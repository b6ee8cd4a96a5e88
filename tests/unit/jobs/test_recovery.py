"""What recovery decides where the record and the bucket tell of one job differently."""

from collections.abc import Callable, Iterator, Sequence
from urllib.parse import urlsplit

import pytest

from core.adapters.memory.objects import MemoryObjectStore
from core.adapters.memory.queue import MemoryJobQueue
from core.adapters.postgres.engine import connect_postgres
from core.adapters.postgres.store import PostgresJobStore
from core.errors import JobUnreadable, ModelNotFound, StaleJob
from core.jobs import feeds
from core.jobs.attempts import Claim
from core.jobs.cancellation import cancel
from core.jobs.job import Job
from core.jobs.record_copy import copy_record, read_copy
from core.jobs.recovery.finding import Finding
from core.jobs.recovery.findings import findings
from core.jobs.status import JobStatus
from core.jobs.store import JobStore
from core.reasons import Reason
from core.storage import keys
from core.user_models.record import ModelRecord
from tests.conftest import Databases
from tests.unit.jobs.playing import LEASE, PlayedWorker

NOBODYS = "019aa3c2f0b1-0000000000"


@pytest.fixture
def objects() -> MemoryObjectStore:
    return MemoryObjectStore()


@pytest.fixture
def worker(jobs: JobStore, objects: MemoryObjectStore) -> PlayedWorker:
    return PlayedWorker(jobs, objects)


@pytest.fixture
def saved(
    databases: Databases, job_store: PostgresJobStore, database_url: str
) -> Iterator[Callable[[], PostgresJobStore]]:
    """A copy of the record as it is when this is called."""
    made: list[tuple[str, PostgresJobStore]] = []

    def save() -> PostgresJobStore:
        job_store.close()  # A database with connections cannot be copied.
        name = urlsplit(database_url).path.removeprefix("/")
        databases.admin.execute(f"CREATE DATABASE {name}_{len(made)} TEMPLATE {name}")
        url = database_url.replace(name, f"{name}_{len(made)}")
        made.append((url, PostgresJobStore(connect_postgres(url))))
        return made[-1][1]

    yield save
    for url, store in made:
        store.close()
        databases.drop(url)


def found(store: JobStore, objects: MemoryObjectStore) -> list[Finding]:
    return list(findings(store=store, objects=objects))


def recover(store: JobStore, objects: MemoryObjectStore) -> Sequence[str]:
    """Act on everything; what was found. Nothing is found after it."""
    said: list[str] = []
    for finding in findings(store=store, objects=objects):
        finding.act()
        said.append(finding.sentence)
    assert [finding for finding in found(store, objects) if finding.remedy is not None] == []
    return said


def forget(store: JobStore, job_id: str, version: int) -> None:
    """Leave no trace of the job in the record, as a database restored to a moment before it."""
    store.delete(job_id, version)
    store.deletion_ended(job_id)


def steps(job: Job) -> list[int | None]:
    return [artifact.step for artifact in job.artifacts]


def holding_at(claim: Claim, store: JobStore) -> Claim:
    """The same attempt, as the database was restored beneath it."""
    return Claim(claim.job_id, claim.number, claim.token, store, claim.objects)


class TestForgottenJobs:
    def test_files_that_are_lost_are_left_out(self, jobs: JobStore, worker: PlayedWorker) -> None:
        job = worker.run(steps=2)
        forget(jobs, job.id, job.version)
        worker.objects.delete_prefix(job.artifacts[1].key)
        [said] = recover(jobs, worker.objects)
        assert said.endswith("The bucket has it as succeeded, with 1 of its 2 files.")
        assert jobs.get(job.id) == job.model_copy(update={"artifacts": job.artifacts[:1]})

    def test_a_job_that_was_being_cancelled_is_cancelled(self, jobs: JobStore, worker: PlayedWorker) -> None:
        claim = worker.begin(worker.submit())
        cancelling = cancel(claim.job_id, store=jobs, queue=MemoryJobQueue())
        worker.checkpoint(claim, 1)
        forget(jobs, claim.job_id, cancelling.version + 1)
        recover(jobs, worker.objects)
        job = jobs.get(claim.job_id)
        assert (job.status, job.reason) == (JobStatus.CANCELLED, Reason.USER_CANCELLED)
        assert job.attempts[-1].ended_at is not None

    def test_the_last_attempt_is_not_used_up_by_the_disaster(
        self, jobs: JobStore, worker: PlayedWorker
    ) -> None:
        claim = worker.begin(worker.submit(max_attempts=1))
        worker.checkpoint(claim, 1)
        forget(jobs, claim.job_id, jobs.get(claim.job_id).version)
        recover(jobs, worker.objects)
        assert jobs.get(claim.job_id).status == JobStatus.QUEUED

    def test_what_a_deletion_left_is_told_and_not_adopted(self, jobs: JobStore, worker: PlayedWorker) -> None:
        job = worker.run()
        worker.objects.delete_prefix(keys.job(job.id))
        jobs.delete(job.id, job.version)
        copy_record(job, worker.objects)  # The reconciler's copy comes last.
        assert (
            found(jobs, worker.objects) == []
        )  # The reconciler removes it, unless it comes later than that.
        jobs.deletion_ended(job.id)
        [finding] = found(jobs, worker.objects)
        assert finding.remedy is None
        assert "none of its files" in finding.sentence

    def test_objects_without_a_copy_are_told(self, jobs: JobStore, objects: MemoryObjectStore) -> None:
        objects.put(f"jobs/{NOBODYS}/attempts/1/0123456789abcdef/a", b"x")
        [finding] = found(jobs, objects)
        assert finding.remedy is None
        assert "1 such jobs have no copy" in finding.sentence

    @pytest.mark.parametrize("body", [b"", b"[]", b"{}", b'{"spec": {"kind": "dance"}}'])
    def test_a_copy_that_cannot_be_read_is_left(
        self, body: bytes, jobs: JobStore, objects: MemoryObjectStore
    ) -> None:
        objects.put(keys.record(NOBODYS), body)
        [finding] = found(jobs, objects)
        assert finding.remedy == "adopt"
        with pytest.raises(JobUnreadable):
            finding.act()

    def test_a_copy_of_another_job_is_not_taken_for_this_one(
        self, jobs: JobStore, worker: PlayedWorker
    ) -> None:
        job = worker.run()
        worker.objects.put(keys.record(NOBODYS), worker.objects.get(keys.record(job.id)))
        with pytest.raises(JobUnreadable, match=job.id):
            read_copy(NOBODYS, worker.objects)


class TestOlderRecords:
    """The database was restored to an older moment."""

    def test_an_attempt_that_still_holds_its_job_keeps_it(
        self, worker: PlayedWorker, saved: Callable[[], PostgresJobStore]
    ) -> None:
        claim = worker.begin(worker.submit())
        older = saved()
        worker.checkpoint(claim, 1)
        recover(older, worker.objects)
        job = older.get(claim.job_id)
        assert (job.status, steps(job)) == (JobStatus.RUNNING, [1])
        # It goes on where it is, without a break.
        assert older.renew(job.id, claim.token, LEASE) == JobStatus.RUNNING
        again = holding_at(claim, older)
        PlayedWorker(older, worker.objects).checkpoint(again, 2)
        assert steps(older.get(job.id)) == [1, 2]
        assert found(older, worker.objects) == []

    def test_a_cancel_since_then_stays(
        self, worker: PlayedWorker, saved: Callable[[], PostgresJobStore]
    ) -> None:
        claim = worker.begin(worker.submit())
        older = saved()
        worker.checkpoint(claim, 1)
        worker.checkpoint(claim, 2)
        cancel(claim.job_id, store=older, queue=MemoryJobQueue())
        recover(older, worker.objects)
        job = older.get(claim.job_id)
        assert (job.status, steps(job)) == (JobStatus.CANCELLING, [1, 2])

    def test_another_life_since_then_stays_and_takes_the_files(
        self, worker: PlayedWorker, saved: Callable[[], PostgresJobStore]
    ) -> None:
        job = worker.submit()
        older = saved()
        first = worker.begin(job)
        worker.checkpoint(first, 1)
        worker.checkpoint(first, 2)
        worker.succeed(first)
        second = PlayedWorker(older, worker.objects).begin(job)
        recover(older, worker.objects)
        now = older.get(job.id)
        assert (now.status, now.token, steps(now)) == (JobStatus.RUNNING, second.token, [1, 2])
        assert now.version > job.version

    def test_an_end_since_then_stays_and_takes_the_files(
        self, worker: PlayedWorker, saved: Callable[[], PostgresJobStore]
    ) -> None:
        job = worker.submit()
        older = saved()
        claim = worker.begin(job)
        worker.checkpoint(claim, 1)
        worker.succeed(claim)
        cancel(job.id, store=older, queue=MemoryJobQueue())
        recover(older, worker.objects)
        assert (older.get(job.id).status, steps(older.get(job.id))) == (JobStatus.CANCELLED, [1])

    def test_a_feed_goes_on_with_what_the_bucket_has(
        self, worker: PlayedWorker, saved: Callable[[], PostgresJobStore]
    ) -> None:
        claim = worker.begin(worker.submit())
        worker.say(claim, "logs", "1", "2")
        older = saved()
        worker.say(claim, "logs", "3")
        worker.succeed(claim)
        while feeds.compact(store=worker.store, objects=worker.objects):
            pass
        recover(older, worker.objects)
        assert lines(older, worker.objects, claim.job_id) == ["1", "2", "3"]
        assert older.oldest_entries(claim.job_id, "logs", limit=10) == []

    def test_a_feed_that_went_on_otherwise_keeps_its_own_entries(
        self, worker: PlayedWorker, saved: Callable[[], PostgresJobStore]
    ) -> None:
        claim = worker.begin(worker.submit())
        worker.say(claim, "logs", "1", "2")
        older = saved()
        worker.say(claim, "logs", "3", "4")
        worker.succeed(claim)
        while feeds.compact(store=worker.store, objects=worker.objects):
            pass
        PlayedWorker(older, worker.objects).say(holding_at(claim, older), "logs", "other")
        recover(older, worker.objects)
        assert older.get(claim.job_id).status == JobStatus.SUCCEEDED
        assert lines(older, worker.objects, claim.job_id) == ["1", "2", "other"]

    def test_what_has_changed_since_it_was_found_is_not_overwritten(
        self, worker: PlayedWorker, saved: Callable[[], PostgresJobStore]
    ) -> None:
        job = worker.submit()
        older = saved()
        worker.checkpoint(worker.begin(job), 1)
        [finding] = found(older, worker.objects)
        cancel(job.id, store=older, queue=MemoryJobQueue())
        with pytest.raises(StaleJob):
            finding.act()
        assert older.get(job.id).status == JobStatus.CANCELLED


class TestLosses:
    """The bucket was restored to an older moment, or has lost something."""

    def test_a_truncated_file_is_lost(self, jobs: JobStore, worker: PlayedWorker) -> None:
        job = worker.run(steps=2)
        worker.objects.put(job.artifacts[0].key, b"half")
        recover(jobs, worker.objects)
        assert steps(jobs.get(job.id)) == [2]

    def test_a_damaged_checkpoint_that_was_struck_is_not_taken_again(
        self, jobs: JobStore, worker: PlayedWorker
    ) -> None:
        claim = worker.begin(worker.submit())
        worker.checkpoint(claim, 1)
        damaged = worker.checkpoint(claim, 2)
        worker.objects.put(damaged.key, b"x" * damaged.size)
        claim.strike(damaged)
        assert found(jobs, worker.objects) == []

    def test_a_single_entry_that_was_lost_is_named_as_one(self, jobs: JobStore, worker: PlayedWorker) -> None:
        claim = worker.begin(worker.submit())
        worker.say(claim, "logs", "the only line")
        worker.succeed(claim)
        while feeds.compact(store=jobs, objects=worker.objects):
            pass
        for info in worker.objects.list(f"{keys.job(claim.job_id)}logs/"):
            worker.objects.delete_prefix(info.key)
        recover(jobs, worker.objects)
        assert lines(jobs, worker.objects, claim.job_id) == [
            "Entry 1 of this feed was lost from the object store."
        ]

    def test_a_model_whose_file_is_lost_can_be_sent_again(
        self, jobs: JobStore, objects: MemoryObjectStore
    ) -> None:
        model = ModelRecord(
            id=f"sha256:{1:064x}", status="ready", media_type="text/xml", size=1, created_at=jobs.now()
        )
        jobs.add_model(model)
        [said] = recover(jobs, objects)
        assert said == f"Model {model.id}: the bucket has lost its file. It has to be sent again."
        with pytest.raises(ModelNotFound):
            jobs.find_model(model.id)


def lines(store: JobStore, objects: MemoryObjectStore, job_id: str) -> list[str]:
    found = feeds.read(job_id, "logs", store=store, objects=objects)
    assert [int(entry.id) for entry in found] == sorted(int(entry.id) for entry in found)
    return [entry.data["text"] for entry in found]
