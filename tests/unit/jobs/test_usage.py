"""The ledger's entries, and what is summed of them."""

from datetime import UTC, datetime, timedelta

import pytest

from core.jobs.job import Job
from core.jobs.spec import JOB_SPEC
from core.jobs.status import JobStatus
from core.jobs.tallies import PHASE_SECONDS, UPLOADS, Tallies, Tally
from core.jobs.usage import ProjectUsage, RunningAttempt, entries, hours_between, usage_of
from core.jobs.workers import host_and_device
from core.reasons import Reason

NINE = datetime(2026, 11, 20, 9, tzinfo=UTC)
WHO = ("default", "")


def at(minutes: float) -> datetime:
    """Minutes after nine."""
    return NINE + timedelta(minutes=minutes)


def queued(**resources: int) -> Job:
    spec = JOB_SPEC.validate_python({"kind": "train", "environment": "ant", "resources": resources})
    return Job(id="019aa3c2f0b1-5be0c1d2e3", spec=spec, created_at=at(0))


def running(worker: str = "node1:gpu:0,1:a1b2c3") -> Job:
    return queued().claimed(worker, at(50)).running()


def test_an_attempt_is_entered_by_the_hours_in_which_it_ran() -> None:
    job = running().ended(JobStatus.SUCCEEDED, Reason.COMPLETED, "", at(140))
    found = entries(job, JobStatus.RUNNING)
    # From 9:50 to 11:20 on two GPUs.
    assert [(entry.hour, entry.seconds, entry.gpu_seconds) for entry in found] == [
        (at(0), 600, 1200),
        (at(60), 3600, 7200),
        (at(120), 1200, 2400),
    ]
    assert [(entry.jobs, entry.attempts) for entry in found] == [(0, 0), (0, 0), (1, 1)]
    assert {(entry.host, entry.device) for entry in found} == {("node1", "gpu:0,1")}
    assert {(entry.status, entry.reason) for entry in found} == {("succeeded", "completed")}


def test_an_attempt_counts_the_gpus_of_all_its_hosts() -> None:
    job = queued(gpus=4, hosts=2).claimed("node1:gpu:0,1:a1b2c3", at(50)).running()
    (entry,) = entries(job.requeued(Reason.WORKER_LOST, "", at(51)), JobStatus.RUNNING)
    assert (entry.seconds, entry.gpu_seconds) == (60, 240)
    assert RunningAttempt(*WHO, "node1:gpu:0,1:a1b2c3", at(0), hosts=2).num_gpus == 4


def test_an_attempt_counts_the_gpus_that_it_was_given_of_a_pool() -> None:
    worker, given = "node1:gpu:2:a1b2c3", {"gpus": "gpu:2,3"}
    job = queued(gpus=2).claimed(worker, at(50), details=given).running()
    (entry,) = entries(job.requeued(Reason.WORKER_LOST, "", at(51)), JobStatus.RUNNING)
    assert (entry.device, entry.seconds, entry.gpu_seconds) == ("gpu:2,3", 60, 120)
    attempt = RunningAttempt(*WHO, worker, at(0), given="gpu:2,3")
    assert (attempt.where, attempt.num_gpus) == (("node1", "gpu:2,3"), 2)


def test_a_lost_attempt_is_entered_and_its_job_has_not_ended() -> None:
    (entry,) = entries(running("h:cpu").requeued(Reason.WORKER_LOST, "", at(51)), JobStatus.RUNNING)
    assert (entry.jobs, entry.attempts, entry.seconds, entry.gpu_seconds) == (0, 1, 60, 0)
    assert (entry.status, entry.reason) == ("queued", "worker_lost")


def test_a_job_that_is_cancelled_before_it_began_took_nothing() -> None:
    (entry,) = entries(
        queued().ended(JobStatus.CANCELLED, Reason.USER_CANCELLED, "", at(5)), JobStatus.QUEUED
    )
    assert (entry.jobs, entry.attempts, entry.seconds, entry.device) == (1, 0, 0, "")


def test_a_job_that_was_queued_again_and_is_cancelled_enters_its_attempt_once() -> None:
    again = running().requeued(Reason.WORKER_DRAINED, "", at(51))
    (entry,) = entries(again.ended(JobStatus.CANCELLED, Reason.USER_CANCELLED, "", at(55)), JobStatus.QUEUED)
    assert (entry.jobs, entry.attempts, entry.seconds) == (1, 0, 0)


@pytest.mark.parametrize("before", [JobStatus.QUEUED, JobStatus.STARTING])
def test_what_neither_ends_nor_loses_an_attempt_enters_nothing(before: JobStatus) -> None:
    assert entries(running(), before) == []


def test_a_clock_that_was_set_back_takes_no_time_away() -> None:
    (entry,) = entries(running().ended(JobStatus.FAILED, Reason.TIMEOUT, "", at(40)), JobStatus.RUNNING)
    assert (entry.seconds, entry.attempts) == (0, 1)


def test_the_parts_of_a_span_sum_up_to_it() -> None:
    parts = list(hours_between(at(59.5), at(60.5)))
    assert parts == [(at(0), 30), (at(60), 30)]
    assert list(hours_between(at(60), at(60))) == []


@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("node1:gpu:0,1:a1b2c3", ("node1", "gpu:0,1")),
        ("node1:gpu:0-3:a1b2c3", ("node1", "gpu:0-3")),
        ("node1:cpu:a1b2c3", ("node1", "cpu")),
        ("node1:cpu", ("node1", "cpu")),
        ("somebody", ("somebody", "")),
    ],
)
def test_a_workers_name_names_host_and_device(name: str, parts: tuple[str, str]) -> None:
    assert host_and_device(name) == parts


def test_what_runs_now_is_counted_from_the_beginning_of_the_window() -> None:
    ended = {WHO: ProjectUsage(*WHO, jobs=2, attempts=3, seconds=100, gpu_seconds=100)}
    attempts = [RunningAttempt(*WHO, "node1:gpu:0,1:a1b2c3", at(-60))]
    devices = {("node1", "gpu:0,1"): {at(0): 60.0}}
    found = usage_of(ended, devices, attempts, since=at(0), day=at(0), until=at(90))
    assert found.projects == [ProjectUsage(*WHO, 2, 3, 1, 100 + 5400, 100 + 2 * 5400)]
    assert found.hours == [at(0), at(60)]
    # The ledger's minute and the running attempt overlap only by the clocks' error: an hour has 3600 s.
    assert [list(device.seconds) for device in found.devices] == [[3600, 1800]]


def test_tallies_are_taken_once() -> None:
    tallies = Tallies()
    for seconds in (0.5, 1.0, 1.5, 1e6):
        tallies.add(PHASE_SECONDS, seconds, "training")
    tallies.add(UPLOADS, 1)
    histogram, counter = tallies.take()
    # 0.5 and 1 lie below the first bound, 1; 1.5 below the second; the last one beyond all.
    assert histogram.labels == ("training",)
    assert (histogram.buckets[0], histogram.buckets[1], histogram.buckets[-1]) == (2, 1, 1)
    assert histogram.total == 0.5 + 1 + 1.5 + 1e6
    assert counter == Tally("gaitway_uploads", (), (), 1)
    assert tallies.take() == []
