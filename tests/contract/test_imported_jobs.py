"""What the record promises of a job that comes whole from another service."""

import pytest

from core.errors import IdempotencyKeyReused, JobUnreadable
from core.jobs.job import Job, Origin, UnreadableJob
from core.jobs.status import JobStatus
from core.jobs.store import Chunk, Idempotency, JobQuery, JobStore, status_entry
from core.reasons import Reason
from tests.contract.recording import NOW, artifact, queued_job

KEY = Idempotency("once", "of this archive")


def imported() -> Job:
    ended = queued_job().claimed("worker-1", NOW).ended(JobStatus.FAILED, Reason.DIVERGED, "NaN", NOW)
    origin = Origin(job="019aa3c2f0b1-5be0c1d2e3", version="0.2 – 初", imported_at=NOW)
    return ended.model_copy(update={"artifacts": (artifact("a"),), "imported_from": origin})


CHUNKS = (
    Chunk("metrics", 1, 7, "m", 1, "0" * 64),
    Chunk("logs", 1, 2000, "a", 1, "0" * 64),
    Chunk("logs", 2001, 2500, "b", 1, "0" * 64),
)


def test_it_is_read_back_equal_with_its_feeds(jobs: JobStore) -> None:
    job = imported()
    assert jobs.import_job(job, CHUNKS, [status_entry(job, NOW)])
    assert jobs.get(job.id) == job
    assert not jobs.waiting()
    assert not jobs.undispatched()
    events = jobs.feed(job.id, "events")
    [said] = events.entries
    assert (said.id, said.kind, said.time, said.data["status"]) == ("8", "status", NOW, "failed")
    assert (events.chunks, events.last, events.is_end) == ([CHUNKS[0]], 8, True)
    logs = jobs.feed(job.id, "logs", after=2000)
    assert (logs.chunks, logs.entries, logs.last, logs.is_end) == ([CHUNKS[2]], [], 2500, True)


def test_another_job_says_nothing_of_where_it_comes_from(jobs: JobStore) -> None:
    jobs.add(job := queued_job())
    assert jobs.get(job.id).imported_from is None


def test_one_key_makes_one_job(jobs: JobStore) -> None:
    first, second = imported(), imported()
    assert jobs.import_job(first, (), (), idempotency=KEY)
    assert not jobs.import_job(second, CHUNKS, (), idempotency=KEY)
    assert jobs.remembered(KEY) == first
    assert not jobs.chunks([second.id])
    assert list(jobs.list(JobQuery()).jobs) == [first]
    with pytest.raises(IdempotencyKeyReused):
        jobs.remembered(Idempotency(KEY.key, "of another"))


def test_what_the_store_cannot_hold_is_unreadable(jobs: JobStore) -> None:
    job = imported()
    bad = job.model_copy(update={"artifacts": (artifact("a", step=2**63),)})
    with pytest.raises(JobUnreadable):
        jobs.import_job(bad, (), (), idempotency=KEY)
    assert not jobs.list(JobQuery()).jobs
    assert jobs.remembered(KEY) is None


def test_an_origin_that_cannot_be_read_makes_the_job_unreadable(jobs: JobStore) -> None:
    job = imported()
    odd = job.model_copy(update={"imported_from": Origin.model_construct(job="a", version="1")})
    assert jobs.import_job(odd, (), ())
    assert isinstance(jobs.find(job.id), UnreadableJob)
