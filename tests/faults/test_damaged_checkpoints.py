"""A checkpoint whose bytes are not what the record says: the run resumes from the newest whole one."""

from pathlib import Path

import pytest

from core.jobs.job import Artifact, Job
from core.jobs.status import JobStatus
from core.jobs.store import JobStore
from core.reasons import Reason
from tests.faults.bench import Bench, wait_until

NEWEST = "checkpoint-000000000020.msgpack"


@pytest.fixture
def bench(tmp_path: Path, jobs: JobStore) -> Bench:
    return Bench(tmp_path, jobs)


def drained(bench: Bench) -> Job:
    """A queued job that has the checkpoints of steps 10 and 20."""
    job = bench.submit()
    with bench.running(job, "waits") as supervisor:
        supervisor.draining.set()
    drained = bench.store.get(job.id)
    assert [a.step for a in drained.artifacts if a.role == "checkpoint"] == [10, 20]
    return drained


def damage(bench: Bench, job: Job, step: int) -> None:
    """Flip a byte of the checkpoint in the object store."""
    artifact = job.newest("checkpoint", step)
    assert artifact is not None
    body = bytearray(bench.objects.get(artifact.key))
    body[0] ^= 1
    bench.objects.put(artifact.key, bytes(body))


def resumed(bench: Bench, job: Job) -> tuple[Job, int | None, list[str]]:
    """The job after an attempt that resumes; from which step that was, and what people were told."""
    bench.supervisor(job, "goes_on_from_a_checkpoint").run()
    ended = bench.store.get(job.id)
    policy = ended.newest("policy")
    notes = [entry.data["text"] for entry in bench.feed(job, "events", "note")]
    return ended, None if policy is None else policy.step, notes


def test_a_whole_one_is_used_without_a_word(bench: Bench) -> None:
    _, step, notes = resumed(bench, drained(bench))
    assert (step, notes) == (20, [])


def test_a_flipped_byte_in_the_newest_costs_the_steps_since_the_one_before(bench: Bench) -> None:
    job = drained(bench)
    damage(bench, job, 20)
    ended, step, notes = resumed(bench, job)
    assert (ended.status, step) == (JobStatus.SUCCEEDED, 10)
    assert notes == [
        f"{NEWEST} is damaged: its bytes do not have the SHA-256 that the record names.",
        "The run resumes from step 10.",
    ]
    # Nobody else is lent the damaged one.
    assert [a.step for a in ended.artifacts if a.role == "checkpoint"] == [10]


def test_one_that_has_gone_is_passed_over(bench: Bench) -> None:
    job = drained(bench)
    newest = job.newest("checkpoint")
    assert newest is not None
    bench.objects.delete_prefix(newest.key)
    _, step, notes = resumed(bench, job)
    assert step == 10
    assert notes[0] == f"{NEWEST} has gone from the object store."


def test_without_a_whole_one_the_run_starts_again(bench: Bench) -> None:
    job = drained(bench)
    damage(bench, job, 10)
    damage(bench, job, 20)
    ended, step, notes = resumed(bench, job)
    assert (ended.status, step) == (JobStatus.SUCCEEDED, 0)
    assert notes[-1] == "No checkpoint of this job is whole: the run starts again."


def borrower(bench: Bench, source: Job, step: int | None) -> Job:
    point = {"job": source.id} if step is None else {"job": source.id, "step": step}
    return bench.submit(resume_from=point)


def test_a_job_that_resumes_from_another_takes_its_newest_whole_one(bench: Bench) -> None:
    source = drained(bench)
    damage(bench, source, 20)
    job = borrower(bench, source, None)
    ended, step, notes = resumed(bench, job)
    assert (ended.status, step) == (JobStatus.SUCCEEDED, 10)
    assert notes[-1] == f"Step 10 of job {source.id} is taken instead."


def test_a_job_that_names_the_step_gets_no_other(bench: Bench) -> None:
    source = drained(bench)
    damage(bench, source, 20)
    job = borrower(bench, source, 20)
    ended, _, _ = resumed(bench, job)
    assert (ended.status, ended.reason) == (JobStatus.FAILED, Reason.BAD_CHECKPOINT)
    assert f"{NEWEST} is damaged" in str(ended.message)
    # No process began, and the log tells why.
    assert f"The job has failed (bad_checkpoint). {NEWEST} is damaged" in " ".join(bench.lines(job))


def test_a_promised_checkpoint_outlives_its_number(bench: Bench) -> None:
    source = bench.submit(checkpoints={"keep": 1})
    with bench.running(source, "waits") as supervisor:
        job = borrower(bench, source, 10)
        supervisor.draining.set()
    steps = [a.step for a in bench.store.get(source.id).artifacts if a.role == "checkpoint"]
    assert steps == [10, 20]
    assert resumed(bench, job)[1] == 10


def evaluated(bench: Bench) -> Job:
    """A queued job whose first attempt was killed after it had kept its best policy."""
    job = bench.run("is_evaluated_and_killed")
    assert job.status == JobStatus.QUEUED
    return job


def went_on(bench: Bench, job: Job) -> Artifact:
    """The best policy that the next attempt kept."""
    wait_until(lambda: bench.store.now() >= (job.not_before or job.created_at))
    bench.supervisor(job, "shows_the_best_before").run()
    kept = bench.store.get(job.id).newest("policy")
    assert kept is not None
    return kept


def test_an_attempt_knows_the_best_policy_of_the_one_before(bench: Bench) -> None:
    job = evaluated(bench)
    kept = went_on(bench, job)
    assert bench.objects.get(kept.key) == b"the best"
    assert kept.metadata["best"] == {"step": 10, "episode_return": 81.5}
    best = bench.store.get(job.id).newest("best_policy")
    assert best is not None
    assert (best.step, best.metadata) == (10, {"return": 81.5})
    [event] = [one for one in bench.feed(job, "events", "artifact") if one.data["role"] == "best_policy"]
    assert (event.data["step"], event.data["return"]) == (10, 81.5)
    assert "Step 10: the best evaluation so far, with a return of 81.5" in " ".join(bench.lines(job))


def test_a_damaged_best_policy_is_replaced_by_the_best_from_then_on(bench: Bench) -> None:
    job = evaluated(bench)
    best = job.newest("best_policy")
    assert best is not None
    bench.objects.put(best.key, b"The best")
    kept = went_on(bench, job)
    assert (bench.objects.get(kept.key), kept.metadata["best"]) == (b"nothing", None)
    assert bench.store.get(job.id).newest("best_policy") is None
    [note] = [entry.data["text"] for entry in bench.feed(job, "events", "note")]
    assert note.startswith("policy-best is damaged")
    assert note.endswith("The best evaluation from now on takes its place.")
