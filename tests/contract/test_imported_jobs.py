"""What the record promises of a job that comes whole from another service."""

from collections.abc import Iterator

import pytest

from core.errors import IdempotencyKeyReused, JobUnreadable
from core.jobs.job import Job, Origin, UnreadableJob
from core.jobs.status import JobStatus
from core.jobs.store import Entry, Idempotency, JobQuery, JobStore, status_entry
from core.reasons import Reason
from tests.contract.recording import NOW, artifact, queued_job

KEY = Idempotency("once", "of this archive")


def imported() -> Job:
    ended = queued_job().claimed("worker-1", NOW).ended(JobStatus.FAILED, Reason.DIVERGED, "NaN", NOW)
    origin = Origin(job="019aa3c2f0b1-5be0c1d2e3", version="0.2 – 初", imported_at=NOW)
    return ended.model_copy(update={"artifacts": (artifact("a"),), "imported_from": origin})


def entries(number: int) -> list[Entry]:
    return [Entry(kind="line", time=NOW, data={"text": str(place)}) for place in range(number)]


def test_it_is_read_back_equal_with_its_feeds(jobs: JobStore) -> None:
    job = imported()
    # More entries than one statement stores.
    assert jobs.import_job(job, [status_entry(job, NOW)], entries(2500))
    assert jobs.get(job.id) == job
    assert not jobs.waiting()
    assert not jobs.undispatched()
    [said] = jobs.feed(job.id, "events").entries
    assert (said.kind, said.time, said.data["status"]) == ("status", NOW, "failed")
    assert jobs.feed(job.id, "logs", after=2499, limit=10).entries[0].data == {"text": "2499"}


def test_another_job_says_nothing_of_where_it_comes_from(jobs: JobStore) -> None:
    jobs.add(job := queued_job())
    assert jobs.get(job.id).imported_from is None


def test_one_key_makes_one_job(jobs: JobStore) -> None:
    first, second = imported(), imported()
    assert jobs.import_job(first, (), (), idempotency=KEY)
    assert not jobs.import_job(second, (), entries(1), idempotency=KEY)
    assert jobs.remembered(KEY) == first
    assert list(jobs.list(JobQuery()).jobs) == [first]
    with pytest.raises(IdempotencyKeyReused):
        jobs.remembered(Idempotency(KEY.key, "of another"))


def test_a_feed_that_breaks_leaves_neither_job_nor_key(jobs: JobStore) -> None:
    def broken() -> Iterator[Entry]:
        yield from entries(1500)
        raise ValueError("broken")

    with pytest.raises(ValueError, match="broken"):
        jobs.import_job(imported(), (), broken(), idempotency=KEY)
    assert not jobs.list(JobQuery()).jobs
    assert jobs.remembered(KEY) is None


def test_what_the_store_cannot_hold_is_unreadable(jobs: JobStore) -> None:
    job = imported()
    bad = job.model_copy(update={"artifacts": (artifact("a", step=2**63),)})
    with pytest.raises(JobUnreadable):
        jobs.import_job(bad, (), ())
    assert not jobs.list(JobQuery()).jobs


def test_an_origin_that_cannot_be_read_makes_the_job_unreadable(jobs: JobStore) -> None:
    job = imported()
    odd = job.model_copy(update={"imported_from": Origin.model_construct(job="a", version="1")})
    assert jobs.import_job(odd, (), ())
    assert isinstance(jobs.find(job.id), UnreadableJob)
