"""The worker that RQ knows, in this process."""

import contextlib
import os
import signal
import subprocess
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
from rq.exceptions import StopRequested
from rq.worker import WorkerStatus

from core.adapters.postgres.store import PostgresJobStore
from core.errors import RecordsUnavailable
from core.jobs.attempts import Claim
from core.jobs.queue import MODELS, PREVIEWS, queue_names
from core.jobs.status import JobStatus
from core.jobs.tallies import Tally
from core.jobs.workers import WorkerInfo
from core.reasons import Reason
from core.settings import WorkerSettings
from tests.contract.recording import held, queued_job
from tests.in_memory import MemoryObjectStore
from worker.host.device_health import DeviceHealth, mark_of
from worker.host.locks import slot, slot_names, take_lock
from worker.main import GaitwayWorker
from worker.supervision.outcome import Outcome
from worker.supervision.spool import leave, spool


@pytest.fixture(autouse=True)
def signals_as_before() -> Iterator[None]:
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


class InterruptedStore:
    """The worker is told to go while it announces itself. Where that raises, so does the driver: its own."""

    def announce(self, worker: WorkerInfo, ttl: timedelta) -> None:
        try:
            os.kill(os.getpid(), signal.SIGTERM)
        except Exception as error:
            raise RecordsUnavailable("another command is already in progress") from error

    def add_tallies(self, tallies: Sequence[Tally]) -> None:
        pass


def test_a_worker_that_is_told_to_go_while_it_announces_itself_goes(settings: WorkerSettings) -> None:
    store: Any = InterruptedStore()
    worker = GaitwayWorker(settings, "cpu", store)
    signal.signal(signal.SIGTERM, worker.request_stop)
    with pytest.raises(StopRequested):
        worker.announce()


def test_a_worker_that_waits_for_a_job_goes_at_once(settings: WorkerSettings) -> None:
    store: Any = InterruptedStore()
    worker = GaitwayWorker(settings, "cpu", store)
    signal.signal(signal.SIGTERM, worker.request_stop)
    with pytest.raises(StopRequested):
        os.kill(os.getpid(), signal.SIGTERM)


def test_a_worker_goes_at_its_next_heartbeat_where_something_swallowed_the_stop(
    settings: WorkerSettings, job_store: PostgresJobStore
) -> None:
    worker = GaitwayWorker(settings, "cpu", job_store)
    signal.signal(signal.SIGTERM, worker.request_stop)
    with contextlib.suppress(Exception):
        os.kill(os.getpid(), signal.SIGTERM)
    with pytest.raises(StopRequested):
        worker.heartbeat()


def test_a_work_horse_that_missed_the_stop_is_told_again(
    settings: WorkerSettings, job_store: PostgresJobStore
) -> None:
    worker = GaitwayWorker(settings, "cpu", job_store)
    worker.set_state(WorkerStatus.BUSY)
    signal.signal(signal.SIGTERM, worker.request_stop)
    os.kill(os.getpid(), signal.SIGTERM)
    with subprocess.Popen(["sleep", "60"]) as horse:
        worker._horse_pid = horse.pid
        worker.heartbeat()
        assert horse.wait() == -signal.SIGTERM


def test_a_second_sigterm_ends_no_job_at_once(settings: WorkerSettings, job_store: PostgresJobStore) -> None:
    """Slurm sends it to all processes, and a batch script passes it on."""
    worker = GaitwayWorker(settings, "cpu", job_store)
    worker.set_state(WorkerStatus.BUSY)
    signal.signal(signal.SIGTERM, worker.request_stop)
    for _ in range(3):
        os.kill(os.getpid(), signal.SIGTERM)
    # It would be `request_force_stop`, which kills the work-horse.
    assert signal.getsignal(signal.SIGTERM) == worker.request_stop


def test_a_worker_without_a_job_ends_after_its_time_and_one_with_a_job_does_not(
    settings: WorkerSettings, job_store: PostgresJobStore
) -> None:
    brief = settings.model_copy(update={"idle_exit": timedelta(microseconds=1)})
    worker = GaitwayWorker(brief, "cpu", job_store)
    worker.set_state(WorkerStatus.BUSY)
    worker.heartbeat()
    worker.set_state(WorkerStatus.IDLE)
    with pytest.raises(StopRequested):
        worker.heartbeat()


def test_a_worker_drains_before_its_machine_is_taken_away(
    settings: WorkerSettings, job_store: PostgresJobStore
) -> None:
    soon = datetime.now(UTC) + settings.grace
    worker = GaitwayWorker(settings.model_copy(update={"ends_at": soon}), "cpu", job_store)
    worker.set_state(WorkerStatus.BUSY)
    with subprocess.Popen(["sleep", "60"]) as horse:
        worker._horse_pid = horse.pid
        worker.heartbeat()
        assert horse.wait() == -signal.SIGTERM


def test_what_a_killed_work_horse_has_left_on_the_disk_is_removed(
    settings: WorkerSettings, job_store: PostgresJobStore
) -> None:
    left, held = (settings.data_dir / "spool" / name for name in ("killed.1", "lives.1"))
    left.mkdir(parents=True)
    left.joinpath("checkpoint").write_bytes(b"x")
    for name in ("killed", "lives"):
        lock = settings.data_dir / "locks" / f"{name}.lock"
        lock.parent.mkdir(exist_ok=True)
        lock.touch()
    worker = GaitwayWorker(settings, "cpu", job_store)
    descriptor = take_lock(settings.data_dir / "locks" / "lives.lock")
    assert descriptor is not None
    with spool(held):
        worker.heartbeat()
        assert [path.name for path in (settings.data_dir / "locks").iterdir()] == ["lives.lock"]
        assert held.is_dir()
        assert not left.exists()
    os.close(descriptor)


def test_a_worker_tells_how_an_attempt_ended_that_was_left_on_its_disk(
    settings: WorkerSettings, job_store: PostgresJobStore
) -> None:
    job = held(job_store, queued_job())
    claim = Claim(job.id, 1, job.token, job_store, MemoryObjectStore())
    leave(settings.data_dir, claim, Outcome(None, Reason.WORKER_DRAINED, "Shut down."))
    (settings.data_dir / "left" / "damaged.json").write_text("{")
    GaitwayWorker(settings, "cpu", job_store).heartbeat()
    told = job_store.get(job.id)
    assert (told.status, told.attempts[-1].reason) == (JobStatus.QUEUED, Reason.WORKER_DRAINED)
    assert list((settings.data_dir / "left").iterdir()) == []


def test_a_job_has_its_turn_after_a_preview_and_a_model(
    settings: WorkerSettings,
) -> None:
    """L10: previews alone kept all workers from jobs."""
    store: Any = InterruptedStore()
    worker = GaitwayWorker(settings, "cpu", store)
    previews, models, *jobs = worker.queues

    def next_queues() -> list[str]:
        return [queue.name for queue in worker._ordered_queues]

    assert (previews.name, next_queues()) == (PREVIEWS, list(queue_names("cpu")))
    worker.reorder_queues(previews)
    assert next_queues() == [MODELS, *(queue.name for queue in jobs), PREVIEWS]
    worker.reorder_queues(models)
    assert next_queues() == [*(queue.name for queue in jobs), PREVIEWS, MODELS]
    worker.reorder_queues(jobs[0])
    assert next_queues() == list(queue_names("cpu"))


def test_a_worker_of_a_pool_asks_for_no_more_gpus_than_are_free(
    settings: WorkerSettings, job_store: PostgresJobStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("worker.host.device.visible_gpus", lambda dev=None: ["nvidia0", "nvidia1", "nvidia2"])
    names = slot_names("gpu:0,1,2", 0)
    works = DeviceHealth("gpu:0", settings.data_dir, names[:1], None)
    worker = GaitwayWorker(settings.model_copy(update={"pool": "gpu:0-2"}), "gpu:0", job_store, works)
    mark_of(settings.data_dir, names[2]).parent.mkdir(parents=True)
    mark_of(settings.data_dir, names[2]).touch()
    assert worker._is_complete()
    asked = [queue.name for queue in worker._ordered_queues]
    assert "gaitway-gpu2-high" in asked
    assert "gaitway-gpu3-high" not in asked
    with slot(settings.data_dir / "locks" / f"{names[0]}.lock", 0.0):
        assert not worker._is_complete()
        worker.announce()
        (found,) = job_store.workers()
    assert (found.state, found.pool) == ("lent", "gpu:0,1,2")
    assert found.problem == "Another process of this machine uses its GPU."
