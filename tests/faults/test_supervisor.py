"""The supervisor against processes that do well, badly, and worse; the objects are in memory."""

import json
import os
import signal
import threading
from datetime import timedelta
from pathlib import Path
from typing import Any

import psutil
import pytest

from core.adapters.postgres.store import PostgresJobStore
from core.algorithms.ppo.spec import PPOSpec
from core.errors import RecordsUnavailable, StorageUnavailable
from core.jobs.job import utc_now
from core.jobs.queue import queue_names
from core.jobs.status import JobStatus
from core.reasons import Reason
from tests.contract.recording import worker
from tests.faults.bench import Bench
from worker.host.device_health import mark_of
from worker.host.locks import slot


@pytest.fixture
def bench(tmp_path: Path, job_store: PostgresJobStore) -> Bench:
    return Bench(tmp_path, job_store)


def test_what_the_process_says_becomes_facts(bench: Bench) -> None:
    job = bench.run("succeeds")
    assert (job.status, job.reason) == (JobStatus.SUCCEEDED, Reason.COMPLETED)
    assert (job.progress.step, job.progress.total, job.progress.steps_per_second) == (20, 20, 5.0)
    assert (job.attempts[0].device, job.attempts[0].details) == ("probe", {"answer": 42})
    assert [a.step for a in job.artifacts if a.role == "checkpoint"] == [10, 20]
    checkpoint = job.newest("checkpoint")
    assert checkpoint is not None
    assert bench.objects.get(checkpoint.key) == b"state 20"
    rows = bench.feed(job, "events", kind="metrics")
    assert [row.data["values"] for row in rows] == [
        {"eval/episode_reward": 10.0},
        {"eval/episode_reward": 20.0},
    ]
    assert bench.printed(job) == ["a line of the log"]


def test_the_metrics_are_a_file_when_the_attempt_ends(bench: Bench) -> None:
    """M3: no checkpoint stores them again."""
    job = bench.run("succeeds")
    metrics = job.newest("metrics")
    assert metrics is not None
    lines = [json.loads(line) for line in bench.objects.get(metrics.key).splitlines()]
    assert [line["step"] for line in lines] == [10, 20]
    assert sum(one.key.endswith("metrics.jsonl") for one in bench.objects.list("")) == 1


@pytest.mark.parametrize("models", ["confined", "unconfined"])
def test_the_process_is_told_the_workers_setting_for_models(bench: Bench, models: str) -> None:
    job = bench.submit()
    supervisor = bench.supervisor(job, "succeeds")
    supervisor.settings = bench.settings.model_copy(update={"models": models})
    supervisor.command = ("/bin/sh", "-c", "echo $GAITWAY_MODELS")
    supervisor.run()
    assert bench.printed(job) == [models]


def test_nothing_is_left_in_the_spool(bench: Bench) -> None:
    bench.run("succeeds")
    assert list((bench.settings.data_dir / "spool").iterdir()) == []


def test_a_failure_carries_the_process_own_reason(bench: Bench) -> None:
    job = bench.run("fails")
    assert (job.status, job.reason) == (JobStatus.FAILED, Reason.DIVERGED)
    assert job.message == "The reward became non-finite at environment step 7."


def test_a_crash_without_a_word_is_said_to_be_one_and_its_log_is_there(bench: Bench) -> None:
    job = bench.run("crashes")
    assert (job.status, job.reason) == (JobStatus.FAILED, Reason.TRAINING_CRASHED)
    assert bench.printed(job) == ["Traceback: something"]


def test_a_killed_process_gives_the_job_another_attempt_that_starts_from_the_checkpoint(bench: Bench) -> None:
    job = bench.run("is_killed")
    assert (job.status, job.attempts[0].reason) == (JobStatus.QUEUED, Reason.TRAINING_KILLED)
    bench.supervisor(job, "goes_on_from_a_checkpoint").run()
    done = bench.store.get(job.id)
    policy = done.newest("policy")
    assert done.status == JobStatus.SUCCEEDED
    assert policy is not None
    assert (bench.objects.get(policy.key), policy.step) == (b"state", 10)


def test_an_attempt_that_goes_on_keeps_the_hyperparameters_and_the_engine_of_the_one_before(
    bench: Bench,
) -> None:
    job = bench.run("says_what_it_runs_on_and_is_killed")
    bench.supervisor(job, "keeps_its_task").run()
    kept = bench.store.get(job.id).newest("policy")
    assert kept is not None
    task = json.loads(bench.objects.get(kept.key))
    # Tuned values may have changed since, with the version of a worker; its checkpoint would not fit them.
    assert task["spec"]["algorithm"] == {"kind": "ppo", "num_envs": 64, "learning_rate": 0.125}
    assert task["begun_on"] == "mjx"


def test_a_job_that_resumes_from_another_knows_the_engine_that_moved_its_environments(bench: Bench) -> None:
    source = bench.run("says_what_it_runs_on_and_is_killed")
    same = PPOSpec(num_envs=64).model_dump(mode="json")
    job = bench.submit(resume_from={"job": source.id}, algorithm=same)
    bench.supervisor(job, "keeps_its_task").run()
    kept = bench.store.get(job.id).newest("policy")
    assert kept is not None
    task = json.loads(bench.objects.get(kept.key))
    assert (task["source_engine"], task["begun_on"]) == ("mjx", None)


def test_attempts_run_out(bench: Bench) -> None:
    job = bench.run("is_killed", max_attempts=1)
    assert (job.status, job.reason) == (JobStatus.FAILED, Reason.TRAINING_KILLED)


def test_a_cancel_keeps_the_checkpoint_and_the_video_of_that_moment(bench: Bench) -> None:
    job = bench.submit()
    with bench.running(job, "waits"):
        bench.cancel(job)
    ended = bench.store.get(job.id)
    assert (ended.status, ended.reason) == (JobStatus.CANCELLED, Reason.USER_CANCELLED)
    assert [a.step for a in ended.artifacts if a.role == "checkpoint"] == [10, 20]
    assert ended.newest("video", 20) is not None


def test_a_drain_gives_the_job_back_with_its_checkpoint_and_no_video(bench: Bench) -> None:
    job = bench.submit(max_attempts=1)
    with bench.running(job, "waits") as supervisor:
        supervisor.draining.set()
    ended = bench.store.get(job.id)
    assert (ended.status, ended.attempts[0].reason) == (JobStatus.QUEUED, Reason.WORKER_DRAINED)
    assert [a.step for a in ended.artifacts if a.role == "checkpoint"] == [10, 20]
    assert ended.newest("video") is None


def test_a_training_that_makes_room_hears_it_with_its_lease_and_is_given_back_with_its_checkpoint(
    bench: Bench,
) -> None:
    here = worker("w").model_copy(update={"queues": queue_names("cpu")})
    bench.store.announce(here, timedelta(seconds=40))
    job = bench.submit(max_attempts=1)
    with bench.running(job, "waits"):
        urgent = bench.submit(priority="high")
        assert bench.store.make_room() == {urgent.id: [job.id]}
    ended = bench.store.get(job.id)
    (attempt,) = ended.attempts
    assert (ended.status, attempt.reason) == (JobStatus.QUEUED, Reason.PREEMPTED)
    assert attempt.message == f"It made room for job {urgent.id}. The work up to then is kept."
    assert [a.step for a in ended.artifacts if a.role == "checkpoint"] == [10, 20]


def test_a_drain_after_the_end_of_the_work_keeps_the_metrics_of_a_job_that_nobody_takes_again(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = bench.submit()
    supervisor = bench.supervisor(job, "succeeds")
    record = bench.store.record

    def and_drain(*args: Any, **kwargs: Any) -> Any:
        if any("The job has succeeded" in entry.data.get("text", "") for entry in args[3]):
            supervisor.draining.set()
        return record(*args, **kwargs)

    monkeypatch.setattr(bench.store, "record", and_drain)
    supervisor.run()
    ended = bench.store.get(job.id)
    assert ended.status == JobStatus.SUCCEEDED
    assert ended.newest("metrics") is not None


def test_a_drain_that_finds_nothing_new_to_keep_kills_nobody(bench: Bench) -> None:
    job = bench.submit()
    with bench.running(job, "has_nothing_new_to_keep") as supervisor:
        supervisor.draining.set()
    (attempt,) = bench.store.get(job.id).attempts
    assert attempt.reason == Reason.WORKER_DRAINED
    assert attempt.message == "The worker was shut down. The work up to then is kept."


def test_a_drain_is_said_again_to_who_missed_it(bench: Bench) -> None:
    job = bench.submit()
    with bench.running(job, "misses_the_first_word_to_go") as supervisor:
        supervisor.draining.set()
    (attempt,) = bench.store.get(job.id).attempts
    assert attempt.message == "The worker was shut down. The work up to then is kept."


def test_a_signal_to_all_processes_of_a_worker_is_a_drain(bench: Bench) -> None:
    """Slurm ends a job so: the training may hear of it, and end, before its supervisor does."""
    job = bench.submit(max_attempts=1)
    with bench.running(job, "waits") as supervisor:
        (training,) = [one for one in psutil.Process().children() if "waits" in one.cmdline()]
        training.send_signal(signal.SIGTERM)
        threading.Timer(0.3, supervisor.draining.set).start()
    ended = bench.store.get(job.id)
    assert (ended.status, ended.attempts[0].reason) == (JobStatus.QUEUED, Reason.WORKER_DRAINED)


def test_a_drain_is_heard_by_who_waits_for_the_device(bench: Bench) -> None:
    bench.settings = bench.settings.model_copy(update={"grace": timedelta(seconds=30)})
    job = bench.submit(max_attempts=1)
    supervisor = bench.supervisor(job, "succeeds")
    threading.Timer(0.2, supervisor.draining.set).start()
    with slot(bench.settings.data_dir / "locks" / "slot.lock", 0):
        supervisor.run()
    ended = bench.store.get(job.id)
    assert (ended.status, ended.attempts[0].reason) == (JobStatus.QUEUED, Reason.WORKER_DRAINED)
    assert ended.attempts[0].message == "The worker was shut down before it had started the job."


def test_a_drain_is_heard_by_who_waits_for_a_store(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    job = bench.run("is_killed", max_attempts=2)  # It leaves a checkpoint to go on from.

    def away(*_: Any, **__: Any) -> None:
        raise StorageUnavailable("The test switched it off.")

    monkeypatch.setattr(bench.objects, "open", away)
    supervisor = bench.supervisor(job, "succeeds")
    threading.Timer(0.2, supervisor.draining.set).start()
    supervisor.run()
    ended = bench.store.get(job.id)
    assert (ended.status, ended.attempts[1].reason) == (JobStatus.QUEUED, Reason.WORKER_DRAINED)
    assert list((bench.settings.data_dir / "spool").iterdir()) == []


def test_a_timeout_is_a_failure_that_keeps_the_work(bench: Bench) -> None:
    # Long enough for the process to begin, also on a busy machine: it has to hear that it shall go.
    job = bench.run("waits", timeout_s=2)
    assert (job.status, job.reason) == (JobStatus.FAILED, Reason.TIMEOUT)
    assert job.newest("checkpoint", 20) is not None
    assert job.newest("video", 20) is not None


def test_who_does_not_listen_is_killed_after_the_grace_time(bench: Bench) -> None:
    bench.settings = bench.settings.model_copy(update={"grace": timedelta(seconds=1)})
    job = bench.submit()
    with bench.running(job, "ignores_signals"):
        bench.cancel(job)
    ended = bench.store.get(job.id)
    assert ended.status == JobStatus.CANCELLED
    assert "killed" in (ended.message or "")
    assert [a.step for a in ended.artifacts if a.role == "checkpoint"] == [10]


def test_a_child_that_the_process_leaves_behind_is_ended(bench: Bench) -> None:
    job = bench.run("leaves_a_child")
    summary = job.newest("summary")
    assert summary is not None
    child = int(bench.objects.get(summary.key))
    with pytest.raises(ProcessLookupError):
        os.kill(child, 0)


def test_many_lines_halt_nothing_and_are_all_in_the_log(bench: Bench) -> None:
    job = bench.run("prints_much")
    assert job.status == JobStatus.SUCCEEDED
    assert bench.printed(job) == ["x" * 199] * 15_000


def test_a_flood_of_lines_halts_nothing_and_the_log_says_what_is_missing(bench: Bench) -> None:
    job = bench.run("floods")
    assert job.status == JobStatus.SUCCEEDED
    lines = bench.printed(job)
    left_out = [int(line[1:].split()[0]) for line in lines if line.startswith("[")]
    assert left_out
    assert lines.count("x" * 199) + sum(left_out) == 50_000


def test_an_attempt_whose_job_was_taken_stops_and_writes_no_more(bench: Bench) -> None:
    job = bench.submit()
    with bench.running(job, "waits"):
        held = bench.store.get(job.id)
        taken = held.requeued(Reason.WORKER_LOST, "taken by a test", utc_now())
        bench.store.save(taken)
    assert bench.store.get(job.id) == taken


def test_an_outage_of_the_records_pauses_bookkeeping_and_not_the_job(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    away = threading.Event()
    record = bench.store.record

    def record_unless_away(*args: Any, **kwargs: Any) -> None:
        if away.is_set():
            raise RecordsUnavailable("The test switched it off.")
        record(*args, **kwargs)

    monkeypatch.setattr(bench.store, "record", record_unless_away)
    away.set()
    threading.Timer(0.5, away.clear).start()
    job = bench.run("succeeds")
    assert job.status == JobStatus.SUCCEEDED
    assert job.progress.step == 20


def test_a_held_device_costs_no_attempt_and_its_worker_is_set_aside(bench: Bench) -> None:
    """M7: it was counted as a lost worker, and each job of the queue failed after three."""
    job = bench.submit(max_attempts=1)
    supervisor = bench.supervisor(job, "succeeds")
    supervisor.settings = bench.settings.model_copy(update={"grace": timedelta(seconds=0.1)})
    with slot(bench.settings.data_dir / "locks" / "slot.lock", 0.0):
        supervisor.run()
    given_back = bench.store.get(job.id)
    assert (given_back.status, given_back.lost_attempts) == (JobStatus.QUEUED, 0)
    assert given_back.attempts[0].reason == Reason.DEVICE_HELD
    assert given_back.not_before is not None
    assert "still uses the device" in mark_of(bench.settings.data_dir, "slot").read_text()
