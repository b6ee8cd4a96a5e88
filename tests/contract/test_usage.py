"""What the record promises of the ledger, and of the numbers for monitoring."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta

from core.jobs.job import Job, utc_now
from core.jobs.status import JobStatus
from core.jobs.store import JobStore
from core.jobs.tallies import PHASE_SECONDS, Tallies
from core.jobs.usage import UnfinishedJobs
from core.reasons import Reason
from tests.contract.recording import LEASE, NOW, Database, cancelled, held, queued_job, taken_back


def begun(jobs: JobStore, job: Job, ago: timedelta, worker: str = "node1:gpu:0,1:a1b2c3") -> Job:
    """The job, held for so long."""
    jobs.add(job)
    claimed = job.claimed(worker, utc_now() - ago)
    jobs.save(claimed, lease=LEASE)
    return claimed


def test_an_attempt_enters_the_ledger_once_with_its_end(jobs: JobStore, database: Database) -> None:
    job = held(jobs, queued_job())
    jobs.save(again := taken_back(job))
    jobs.save(again.claimed("node1:gpu:0:a1b2c3", NOW), lease=LEASE)
    assert database.read("SELECT host, status, reason, attempts, jobs FROM usage") == [
        ("worker-1", "queued", "worker_lost", 1, 0)
    ]


def test_entries_of_one_hour_add_up(jobs: JobStore) -> None:
    for _ in range(2):
        jobs.save(held(jobs, queued_job()).ended(JobStatus.FAILED, Reason.DIVERGED, "", NOW))
    (ended,) = jobs.numbers().ended
    assert (ended.status, ended.reason, ended.jobs, ended.attempts) == ("failed", "diverged", 2, 2)


def test_usage_outlives_its_jobs(jobs: JobStore) -> None:
    job = begun(jobs, queued_job(), timedelta(seconds=90))
    ended = job.requeued(Reason.WORKER_LOST, "", utc_now())
    jobs.save(ended)
    jobs.save(last := cancelled(ended))
    jobs.delete(job.id, last.version)
    (used,) = jobs.usage(utc_now() - timedelta(days=1)).projects
    assert (used.jobs, used.attempts, used.running) == (0, 1, 0)
    assert 180 <= used.gpu_seconds < 190


def test_usage_before_the_window_is_left_out_and_what_runs_is_cut(jobs: JobStore, database: Database) -> None:
    old = begun(jobs, queued_job(), timedelta(seconds=90))
    jobs.save(old.requeued(Reason.WORKER_LOST, "", utc_now()))
    database.change("UPDATE usage SET hour = hour - interval '3 hours'")
    begun(jobs, queued_job(1), timedelta(hours=50))
    since = utc_now() - timedelta(hours=1)
    found = jobs.usage(since)
    (used,) = found.projects
    passed = (found.until - found.since).total_seconds()
    assert 3600 <= passed < 7200
    assert (used.attempts, used.running) == (0, 1)
    assert abs(used.seconds - passed) < 1
    (device,) = found.devices
    assert (device.host, device.device) == ("node1", "gpu:0,1")
    # It had no pause in the last day.
    assert len(device.seconds) == len(found.hours) == 24
    assert set(device.seconds[1:-1]) == {3600.0}


def test_what_waits_now_is_told_by_project_and_user(jobs: JobStore) -> None:
    for number in range(3):
        jobs.add(queued_job(number))
    begun(jobs, queued_job(3), timedelta(seconds=1))
    (used,) = jobs.usage(utc_now()).projects
    assert (used.queued, used.running) == (3, 1)
    assert used.oldest_queued_s is not None
    assert used.oldest_queued_s >= 0


def test_old_entries_forget_their_hosts_and_lose_nothing(jobs: JobStore, database: Database) -> None:
    for number, name in enumerate(("node1:gpu:0:a1b2c3", "node2:gpu:1:a1b2c3", "node2:cpu:a1b2c3")):
        job = begun(jobs, queued_job(number), timedelta(seconds=30), name)
        jobs.save(job.requeued(Reason.WORKER_LOST, "", utc_now()))
    jobs.tidy()
    assert database.count("usage") == 3
    database.change("UPDATE usage SET hour = '2026-01-01 00:00Z'")
    (before,) = jobs.usage(datetime(2025, 1, 1, tzinfo=UTC)).projects
    jobs.tidy()
    assert database.read("SELECT host, device, attempts FROM usage ORDER BY device") == [
        ("", "cpu", 1),
        ("", "gpu", 2),
    ]
    (after,) = jobs.usage(datetime(2025, 1, 1, tzinfo=UTC)).projects
    assert replace(after, oldest_queued_s=before.oldest_queued_s) == before


def test_the_numbers_name_what_runs_and_the_pulse(jobs: JobStore) -> None:
    job = held(jobs, queued_job())
    jobs.beat(LEASE)
    found = jobs.numbers()
    assert [(row.worker, row.started_at) for row in found.running] == [("worker-1", NOW)]
    assert found.unfinished == [UnfinishedJobs("default", job.status.value, 1)]
    assert found.beat_at is not None
    assert found.moment - found.beat_at < timedelta(seconds=10)


def test_tallies_of_all_workers_are_summed_bucket_by_bucket(jobs: JobStore) -> None:
    tallies = Tallies()
    for values in ((0.5, 3.0), (0.7,)):
        for seconds in values:
            tallies.add(PHASE_SECONDS, seconds, "training")
        jobs.add_tallies(tallies.take())
    (found,) = jobs.numbers().tallies
    assert (found.series, found.labels) == ("gaitway_phase_seconds", ("training",))
    assert found.buckets[:3] == (2, 0, 1)
    assert sum(found.buckets) == 3
    assert abs(found.total - 4.2) < 1e-9
    jobs.add_tallies([])
