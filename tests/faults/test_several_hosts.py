"""A job that two hosts share: its parts begin together, and none outlives it, whatever happens to one."""

import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from datetime import timedelta
from pathlib import Path
from typing import Any

import psutil
import pytest

from core.adapters.postgres.store import PostgresJobStore
from core.jobs.job import Job
from core.jobs.queue import queue_names
from core.jobs.status import JobStatus
from core.jobs.workers import WorkerInfo
from core.reasons import Reason
from tests.faults.bench import SPEC, wait_until
from tests.faults.two_hosts import ON_TWO, TwoHosts, probe
from worker.gang.connection import ConnectionLost, connect
from worker.host.child import TRAINING
from worker.host.locks import slots
from worker.supervision.supervisor import Supervisor

Hosts = Callable[..., TwoHosts]


@pytest.fixture
def hosts(tmp_path: Path, job_store: PostgresJobStore) -> Iterator[Hosts]:
    made: list[TwoHosts] = []

    def make(second: Sequence[str], devices: tuple[str, str] = ("cpu", "cpu")) -> TwoHosts:
        made.append(TwoHosts(tmp_path, job_store, second, devices))
        return made[-1]

    yield make
    for one in made:
        one.close()
    assert _processes("spool") == []


def test_both_hosts_take_part_and_the_log_has_the_lines_of_both(
    hosts: Hosts, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PROBE_WAITS_FOR", str(tmp_path / "go"))
    two = hosts(probe("succeeds"))
    job = two.bench.submit(**ON_TWO)
    thread = threading.Thread(target=two.supervisor(job, probe("is_filmed")).run)
    thread.start()
    wait_until(lambda: any(line.endswith(", rank 1] a line of the log") for line in two.bench.printed(job)))
    (tmp_path / "go").touch()
    thread.join(20)
    done = two.bench.store.get(job.id)
    assert (done.status, done.reason) == (JobStatus.SUCCEEDED, Reason.COMPLETED), done.message


@pytest.mark.parametrize(
    ("second", "status", "reason", "message"),
    [
        (
            "is_killed",
            JobStatus.QUEUED,
            Reason.TRAINING_KILLED,
            "(rank 1): The training process was ended by",
        ),
        ("crashes_natively", JobStatus.QUEUED, Reason.NATIVE_CRASH, "(rank 1): Native code"),
        ("fails", JobStatus.FAILED, Reason.DIVERGED, "(rank 1): The reward became non-finite"),
    ],
)
def test_an_end_on_the_second_host_ends_the_attempt_on_both(
    hosts: Hosts, second: str, status: JobStatus, reason: Reason, message: str
) -> None:
    two = hosts(probe(second))
    began = time.monotonic()
    after = two.run(two.bench.submit(**ON_TWO), probe("ignores_signals"))
    assert (after.status, after.reason or after.attempts[0].reason) == (status, reason)
    assert message in (after.attempts[0].message or "")
    assert time.monotonic() - began < 10


def test_a_host_that_is_lost_ends_the_attempt_as_a_lost_worker(hosts: Hosts) -> None:
    two = hosts(probe("waits"))
    supervisor = two.supervisor(two.bench.submit(**ON_TWO), probe("ignores_signals"))
    thread = threading.Thread(target=supervisor.run)
    thread.start()
    job_id = supervisor.claim.job_id
    wait_until(lambda: two.bench.store.get(job_id).newest("checkpoint") is not None)
    # As seen from here, its machine has gone. Its descriptor stays: the supervisor's thread is reading it.
    with socket.socket(fileno=socket.dup(two.gang.members[0].connection.fileno())) as connection:
        connection.shutdown(socket.SHUT_RDWR)
    thread.join(20)
    lost = two.bench.store.get(job_id)
    assert (lost.status, lost.attempts[0].reason) == (JobStatus.QUEUED, Reason.WORKER_LOST)
    assert "is lost" in (lost.attempts[0].message or "")


def test_a_cancel_keeps_the_work_and_ends_both_parts(hosts: Hosts) -> None:
    two = hosts(probe("ignores_signals"))
    job = two.bench.submit(**ON_TWO)
    thread = threading.Thread(target=two.supervisor(job, probe("waits")).run)
    thread.start()
    wait_until(lambda: two.bench.store.get(job.id).newest("checkpoint") is not None)
    two.bench.cancel(job)
    thread.join(20)
    done = two.bench.store.get(job.id)
    assert (done.status, done.reason) == (JobStatus.CANCELLED, Reason.USER_CANCELLED)
    assert done.newest("video") is not None


def test_a_drain_of_the_second_host_gives_the_job_back_with_a_checkpoint(hosts: Hosts) -> None:
    two = hosts(probe("says_a_line_and_waits"))
    job = two.bench.submit(**ON_TWO)
    thread = threading.Thread(target=two.supervisor(job, probe("waits")).run)
    thread.start()
    wait_until(lambda: any(line.endswith(", rank 1] it runs") for line in two.bench.printed(job)))
    wait_until(lambda: two.bench.store.get(job.id).newest("checkpoint") is not None)
    two.draining.set()
    thread.join(20)
    left = two.bench.store.get(job.id)
    assert (left.status, left.attempts[0].reason) == (JobStatus.QUEUED, Reason.WORKER_DRAINED)
    checkpoint = left.newest("checkpoint")
    assert checkpoint is not None
    assert checkpoint.step == 20


def test_a_job_of_both_hosts_makes_room_and_goes_on_after_the_urgent_one(hosts: Hosts) -> None:
    two = hosts(probe("says_a_line_and_waits"))
    store = two.bench.store
    store.announce(
        WorkerInfo(
            name="w",
            host="first",
            pid=1,
            device="cpu",
            hosts=2,
            queues=queue_names("cpu", 2),
            started_at=store.now(),
            seen_at=store.now(),
        ),
        timedelta(seconds=60),
    )
    low = two.bench.submit(**ON_TWO, priority="low")
    thread = threading.Thread(target=two.supervisor(low, probe("waits")).run)
    thread.start()
    wait_until(lambda: any(line.endswith(", rank 1] it runs") for line in two.bench.printed(low)))
    wait_until(lambda: store.get(low.id).newest("checkpoint") is not None)
    # A job of one host has no slot in this gang, so it gets no room here.
    two.bench.submit(resources={"accelerator": "cpu"}, priority="high")
    assert store.make_room() == {}
    urgent = two.bench.submit(**ON_TWO, priority="high")
    assert store.make_room() == {urgent.id: [low.id]}
    thread.join(20)
    left = store.get(low.id)
    assert (left.status, left.attempts[0].reason) == (JobStatus.QUEUED, Reason.PREEMPTED)
    assert (left.attempts[0].message or "").startswith(f"It made room for job {urgent.id}.")
    assert left.lost_attempts == 0
    two.gang.release()
    assert two.run(urgent, probe("succeeds")).status == JobStatus.SUCCEEDED
    after = two.run(low, probe("goes_on_from_a_checkpoint"))
    assert after.status == JobStatus.SUCCEEDED
    policy = after.newest("policy")
    assert policy is not None
    assert (policy.step, two.bench.objects.get(policy.key)) == (20, b"state")


def test_a_drain_before_the_second_host_has_started_gives_the_job_back(hosts: Hosts) -> None:
    two = hosts(probe("never started"))
    supervisor = two.supervisor(two.bench.submit(**ON_TWO), probe("waits"))
    with slots([two.lock_of_the_second], 1.0):
        thread = threading.Thread(target=supervisor.run)
        thread.start()
        job_id = supervisor.claim.job_id
        wait_until(lambda: two.bench.store.get(job_id).newest("checkpoint") is not None)
        two.draining.set()
        thread.join(20)
    left = two.bench.store.get(job_id)
    assert (left.status, left.attempts[0].reason) == (JobStatus.QUEUED, Reason.WORKER_DRAINED)
    assert "before it had started" in (left.attempts[0].message or "")


def test_a_drain_before_the_second_host_has_heard_of_the_job_gives_it_back(hosts: Hosts) -> None:
    two = hosts(probe("never started"))
    supervisor = two.supervisor(two.bench.submit(**ON_TWO), probe("waits"))
    two.draining.set()
    supervisor.run()
    left = two.bench.store.get(supervisor.claim.job_id)
    assert (left.status, left.attempts[0].reason) == (JobStatus.QUEUED, Reason.WORKER_DRAINED)


def test_a_host_with_another_secret_or_another_place_is_refused(hosts: Hosts) -> None:
    two = hosts(probe("succeeds"))
    wait_until(two.gang.look)
    refusals: list[str] = []

    def knock() -> None:
        try:
            connect("127.0.0.1", two.gang.port, b"another secret")
        except ConnectionLost as error:
            refusals.append(str(error))

    thread = threading.Thread(target=knock)
    thread.start()
    while thread.is_alive():
        two.gang.look()
        thread.join(0.01)
    assert "another secret" in refusals[0]
    assert [member.rank for member in two.gang.members] == [1]
    stranger = two.member(rank=7)
    thread = threading.Thread(target=stranger.serve)
    thread.start()
    wait_until(lambda: two.gang.look() and "rank is 7" in two.gang.refused)
    two.draining.set()
    thread.join(20)


@pytest.mark.extra
@pytest.mark.timeout(300)
@pytest.mark.usefixtures("compiled_quickly")
def test_a_run_that_lost_its_second_host_ends_as_an_undisturbed_one(hosts: Hosts) -> None:
    two = hosts(TRAINING)
    small = {**SPEC["algorithm"], "num_timesteps": 6400}
    spec = {**SPEC, **ON_TWO, "algorithm": small, "checkpoints": {"every_steps": 1280}, "video": None}
    undisturbed = two.run(two.bench.submit(**spec))
    assert undisturbed.status == JobStatus.SUCCEEDED, (undisturbed.message, two.bench.lines(undisturbed))
    resumed = _with_a_loss(two, spec)
    for role in ("checkpoint", "policy"):
        one, other = undisturbed.newest(role), resumed.newest(role)
        assert one is not None
        assert other is not None
        assert one.sha256 == other.sha256


@pytest.mark.gpu
@pytest.mark.timeout(900)
def test_two_gpus_as_two_hosts(hosts: Hosts) -> None:
    """Needs two GPUs. Prints the rates of training on one GPU and on both."""
    two = hosts(TRAINING, ("gpu:0", "gpu:1"))
    spec = {
        "algorithm": {"num_timesteps": 20_000_000, "num_evals": 1},
        "checkpoints": {"every_steps": 5_000_000},
        "video": None,
    }
    alone = two.bench.submit(**spec, resources={"gpus": 1})
    Supervisor(two.bench.claim(alone), two.bench.settings, "gpu:0", ("slot",)).run()
    shared = two.run(two.bench.submit(**spec, resources={"gpus": 2, "hosts": 2}))
    resumed = _with_a_loss(two, {**spec, "resources": {"gpus": 2, "hosts": 2}})
    for job in (two.bench.store.get(alone.id), shared, resumed):
        assert job.status == JobStatus.SUCCEEDED, (job.message, two.bench.lines(job))
        print(
            f"{job.spec.resources}: {job.attempts[-1].device}, {job.progress.steps_per_second:,.0f} steps/s"
        )


def _with_a_loss(two: TwoHosts, spec: dict[str, Any]) -> Job:
    """The job after two attempts, the first of which lost the process of the second host."""
    job = two.bench.submit(**spec)
    thread = threading.Thread(target=two.supervisor(job).run)
    thread.start()
    wait_until(lambda: two.bench.store.get(job.id).newest("checkpoint") is not None, 300)
    _processes("rank1")[0].kill()
    thread.join(60)
    lost = two.bench.store.get(job.id)
    assert (lost.status, lost.attempts[0].reason) == (JobStatus.QUEUED, Reason.TRAINING_KILLED), lost.message
    two.gang.release()
    resumed = two.run(job)
    assert resumed.status == JobStatus.SUCCEEDED, (resumed.message, two.bench.lines(resumed))
    return resumed


def _processes(what: str) -> list[psutil.Process]:
    """The training processes, or probes, whose command has this word."""
    return [p for p in psutil.Process().children() if what in " ".join(p.cmdline())]
