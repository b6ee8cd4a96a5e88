"""Submitting, claiming, cancelling, losing, restoring: the use cases over the in-memory twins."""

from datetime import timedelta
from typing import Any

import pytest

from core.adapters.memory_jobs import MemoryJobStore
from core.adapters.memory_objects import MemoryObjectStore
from core.adapters.memory_queue import MemoryJobQueue
from core.errors import (
    IdempotencyKeyReused,
    JobFinished,
    JobNotFinished,
    JobNotFound,
    LeaseLost,
    ObjectNotFound,
    Rejected,
)
from core.jobs.attempts import Holding, claim
from core.jobs.cancellation import cancel
from core.jobs.deletion import delete
from core.jobs.job import Artifact, Job
from core.jobs.reconciliation import reconcile
from core.jobs.spec import JOB_SPEC
from core.jobs.status import JobStatus, Reason
from core.jobs.store import Idempotency
from core.jobs.submission import submit
from core.storage import keys
from tests.unit.jobs.making import NOON, make_job

LEASE = timedelta(seconds=10)


class Service:
    """The three stores, and a clock that tests move."""

    def __init__(self) -> None:
        self.seconds = 0.0
        self.store = MemoryJobStore(clock=lambda: self.seconds)
        self.queue = MemoryJobQueue()
        self.objects = MemoryObjectStore()

    @property
    def now(self) -> Any:
        return NOON + timedelta(seconds=self.seconds)

    @property
    def parts(self) -> dict[str, Any]:
        return {"store": self.store, "queue": self.queue, "objects": self.objects}

    def submit(self, idempotency: Idempotency | None = None, **fields: Any) -> Job:
        spec = JOB_SPEC.validate_python({"kind": "train", "environment": "ant", **fields})
        return submit(spec, **self.parts, now=self.now, idempotency=idempotency)

    def claim(self, job: Job) -> Holding:
        number = self.store.get(job.id).next_attempt
        self.queue.take()
        holding = claim(
            job.id, number, "w", store=self.store, objects=self.objects, lease=LEASE, now=self.now
        )
        assert holding is not None
        return holding

    def reconcile(self) -> int:
        return reconcile(**self.parts, lease=LEASE, now=self.now)

    def status(self, job: Job) -> JobStatus:
        return self.store.get(job.id).status

    def checkpoint(self, holding: Holding, step: int) -> Artifact:
        name = f"checkpoint-{step:012d}.msgpack"
        key = keys.artifact(holding.job_id, holding.number, name)
        self.objects.put(key, b"state")
        return Artifact(name=name, role="checkpoint", media_type="", size=5, sha256="", key=key, step=step)


@pytest.fixture
def service() -> Service:
    return Service()


def test_a_submission_is_durable_recorded_and_dispatched(service: Service) -> None:
    job = service.submit()
    assert Job.model_validate_json(service.objects.get(keys.spec(job.id))) == job
    assert service.store.get(job.id) == job
    assert service.queue.contains(job.id, 1)


@pytest.mark.parametrize(
    ("fields", "pointer"),
    [
        ({"environment": "aunt"}, "/environment"),
        ({"environment": {"id": "ant", "options": {"legs": 5}}}, "/environment/options/legs"),
        ({"video": {"camera": "moon"}}, "/video/camera"),
        ({"algorithm": {"batch_size": 7}}, "/algorithm/batch_size"),
        ({"resume_from": {"job": "000000000000-0000000000"}}, "/resume_from/job"),
    ],
)
def test_what_cannot_run_is_refused_and_leaves_nothing(
    service: Service, fields: dict[str, Any], pointer: str
) -> None:
    with pytest.raises(Rejected) as caught:
        service.submit(**fields)
    assert pointer in [problem.pointer for problem in caught.value.problems]
    assert list(service.objects.list("")) == []
    assert list(service.store.unfinished()) == []
    assert service.queue.take() is None


def test_the_same_key_makes_one_job_and_another_body_under_it_is_refused(service: Service) -> None:
    first = service.submit(Idempotency("key", "body"))
    assert service.submit(Idempotency("key", "body")).id == first.id
    with pytest.raises(IdempotencyKeyReused):
        service.submit(Idempotency("key", "other body"))
    assert len(list(service.store.unfinished())) == 1


def test_a_dispatch_is_claimed_once(service: Service) -> None:
    job = service.submit()
    service.claim(job)
    again = claim(
        job.id, 1, "other", store=service.store, objects=service.objects, lease=LEASE, now=service.now
    )
    assert again is None


def test_a_queued_job_is_cancelled_at_once_and_a_running_one_is_asked(service: Service) -> None:
    queued, running = service.submit(), service.submit()
    assert cancel(queued.id, **service.parts, now=service.now).status == JobStatus.CANCELLED
    assert not service.queue.contains(queued.id, 1)
    holding = service.claim(running)
    holding.start(device="cpu")
    assert cancel(running.id, **service.parts, now=service.now).status == JobStatus.CANCELLING
    assert cancel(running.id, **service.parts, now=service.now).status == JobStatus.CANCELLING
    holding.end(JobStatus.CANCELLED, Reason.USER_CANCELLED, "", service.now)
    assert cancel(running.id, **service.parts, now=service.now).reason == Reason.USER_CANCELLED


def test_what_has_succeeded_cannot_be_cancelled(service: Service) -> None:
    job = service.submit()
    service.claim(job).end(JobStatus.SUCCEEDED, Reason.COMPLETED, "", service.now)
    with pytest.raises(JobFinished):
        cancel(job.id, **service.parts, now=service.now)


def test_a_cancel_that_comes_before_the_start_is_not_lost(service: Service) -> None:
    job = service.submit()
    holding = service.claim(job)
    cancel(job.id, **service.parts, now=service.now)
    assert holding.start(device="cpu").status == JobStatus.CANCELLING


def test_a_job_that_the_queue_forgot_is_dispatched_again(service: Service) -> None:
    job = service.submit()
    service.queue.remove(job.id, 1)
    assert service.reconcile() == 1
    assert service.queue.contains(job.id, 1)
    assert service.reconcile() == 0


def test_a_silent_worker_loses_its_job_and_its_late_writes_change_nothing(service: Service) -> None:
    job = service.submit()
    holding = service.claim(job)
    service.seconds = 9
    assert service.reconcile() == 0
    service.seconds = 21
    assert service.reconcile() == 1
    taken = service.store.get(job.id)
    assert (taken.status, taken.attempts[0].reason) == (JobStatus.QUEUED, Reason.WORKER_LOST)
    with pytest.raises(LeaseLost):
        holding.end(JobStatus.SUCCEEDED, Reason.COMPLETED, "", service.now)
    assert service.store.get(job.id) == taken


def test_when_all_attempts_are_lost_the_job_has_failed(service: Service) -> None:
    job = service.submit(max_attempts=2)
    for attempt in (1, 2):
        service.claim(job)
        service.seconds += 100
        assert service.reconcile() == 1, attempt
    lost = service.store.get(job.id)
    assert (lost.status, lost.reason) == (JobStatus.FAILED, Reason.WORKER_LOST)
    assert "All 2 attempts" in (lost.message or "")


def test_a_drained_attempt_does_not_count(service: Service) -> None:
    job = service.submit(max_attempts=1)
    service.claim(job).give_back(Reason.WORKER_DRAINED, "", service.now)
    assert service.status(job) == JobStatus.QUEUED


def test_a_worker_lost_while_cancelling_leaves_a_cancelled_job(service: Service) -> None:
    job = service.submit()
    service.claim(job)
    cancel(job.id, **service.parts, now=service.now)
    service.seconds = 100
    service.reconcile()
    assert service.status(job) == JobStatus.CANCELLED


def test_only_the_newest_checkpoints_are_kept_and_the_manifest_names_them(service: Service) -> None:
    holding = service.claim(service.submit())
    for step in (10, 20, 30):
        job = holding.publish((service.checkpoint(holding, step),), keep_checkpoints=2)
    assert [a.step for a in job.artifacts] == [20, 30]
    with pytest.raises(ObjectNotFound):
        service.objects.get(keys.artifact(job.id, 1, "checkpoint-000000000010.msgpack"))
    assert b"checkpoint-000000000030" in service.objects.get(keys.manifest(job.id, 1))


def test_an_emptied_store_is_rebuilt_from_the_bucket(service: Service) -> None:
    queued, running, done = service.submit(), service.submit(), service.submit()
    holding = service.claim(running)
    holding.publish((service.checkpoint(holding, 10),), keep_checkpoints=2)
    service.claim(done).end(JobStatus.SUCCEEDED, Reason.COMPLETED, "", service.now)
    service.store, service.queue = MemoryJobStore(), MemoryJobQueue()
    service.seconds = 60
    service.reconcile()
    assert service.status(queued) == JobStatus.QUEUED
    assert service.store.get(done.id).reason == Reason.COMPLETED
    again = service.store.get(running.id)
    assert (again.status, again.next_attempt) == (JobStatus.QUEUED, 2)
    assert [a.step for a in again.artifacts] == [10]
    assert service.queue.contains(running.id, 2)


def test_only_a_job_that_has_ended_is_deleted_and_then_nothing_is_left(service: Service) -> None:
    job = service.submit()
    with pytest.raises(JobNotFinished):
        delete(job.id, **service.parts)
    cancel(job.id, **service.parts, now=service.now)
    delete(job.id, **service.parts)
    assert list(service.objects.list("")) == []
    with pytest.raises(JobNotFound):
        service.store.get(job.id)


def test_a_rollout_needs_a_job_with_a_checkpoint_in_the_same_environment(service: Service) -> None:
    job = service.submit()
    policy = {"kind": "checkpoint", "job": job.id}

    def roll_out(environment: str) -> Job:
        spec = JOB_SPEC.validate_python({"kind": "rollout", "environment": environment, "policy": policy})
        return submit(spec, **service.parts, now=service.now)

    with pytest.raises(Rejected, match="no checkpoint"):
        roll_out("ant")
    holding = service.claim(job)
    holding.publish((service.checkpoint(holding, 10),), keep_checkpoints=2)
    assert roll_out("ant").spec.kind == "rollout"
    with pytest.raises(Rejected, match="must be the same"):
        roll_out("hopper")


def test_a_rollout_that_would_not_fit_into_memory_is_refused(service: Service) -> None:
    spec = JOB_SPEC.validate_python(
        {
            "kind": "rollout",
            "environment": "ant",
            "policy": {"kind": "zero"},
            "num_steps": 100_000,
            "num_episodes": 1000,
        }
    )
    with pytest.raises(Rejected, match="100,000,000") as caught:
        submit(spec, **service.parts, now=service.now)
    assert [problem.pointer for problem in caught.value.problems] == ["/num_steps", "/num_episodes"]


@pytest.mark.parametrize(
    ("fields", "sentence", "pointers"),
    [
        (
            {"resources": {"accelerator": "cpu", "gpus": 2}},
            "2 GPUs are asked for, and an accelerator that is a CPU",
            ["/resources/accelerator", "/resources/gpus"],
        ),
        (
            {"kind": "rollout", "policy": {"kind": "zero"}, "resources": {"gpus": 2}},
            "A rollout runs on one GPU, and 2 are asked for",
            ["/resources/gpus"],
        ),
        (
            # 6 × 4 = 24 unrolls of 8 worlds go together, but neither 6 nor 8 are shared by four or three.
            {"resources": {"gpus": 4}, "algorithm": {"num_envs": 8, "batch_size": 6, "num_minibatches": 4}},
            "batch_size = 6 is not a multiple of the 4 devices",
            ["/algorithm/batch_size"],
        ),
        (
            {"resources": {"gpus": 3}, "algorithm": {"num_envs": 8, "batch_size": 6, "num_minibatches": 4}},
            "num_envs = 8 is not a multiple of the 3 devices",
            ["/algorithm/num_envs"],
        ),
    ],
)
def test_gpus_that_cannot_share_a_job_are_refused_with_the_places(
    fields: dict[str, Any], sentence: str, pointers: list[str], service: Service
) -> None:
    spec = JOB_SPEC.validate_python({"kind": "train", "environment": "ant", **fields})
    with pytest.raises(Rejected, match=sentence) as caught:
        submit(spec, **service.parts, now=service.now)
    assert [problem.pointer for problem in caught.value.problems] == pointers


def test_a_job_for_two_gpus_waits_for_them_however_often_it_is_dispatched(service: Service) -> None:
    job = service.submit(resources={"gpus": 2})
    assert (job.accelerator, service.queue.take("cpu"), service.queue.take("gpu:0")) == ("gpu", None, None)
    service.queue.remove(job.id, 1)  # as an emptied Redis does
    reconcile(**service.parts, lease=LEASE, now=service.now)
    dispatch = service.queue.take("gpu:0,1")
    assert dispatch is not None
    assert dispatch.job_id == job.id


def test_a_job_of_another_shape_cannot_go_on_from_a_checkpoint(service: Service) -> None:
    job = service.submit()
    holding = service.claim(job)
    holding.start(device="cpu", details={"hyperparameters": {"kind": "ppo", "num_envs": 64}})
    holding.publish((service.checkpoint(holding, 10),), keep_checkpoints=2)
    with pytest.raises(Rejected, match="made with num_envs = 64; this job has 256") as caught:
        service.submit(resume_from={"job": job.id}, resources={"accelerator": "cpu"})
    assert "/algorithm/num_envs" in [problem.pointer for problem in caught.value.problems]


def test_a_job_cannot_go_on_from_worlds_of_warp_on_another_engine_nor_the_other_way_round(
    service: Service,
) -> None:
    for had, has in (("warp", "mjx"), ("native", "warp")):
        job = service.submit()
        holding = service.claim(job)
        holding.start(device="NVIDIA H200", engine=had, details={})
        holding.publish((service.checkpoint(holding, 10),), keep_checkpoints=2)
        with pytest.raises(Rejected, match=f"worlds of the engine {had}, and a run on {has}") as caught:
            service.submit(resume_from={"job": job.id}, physics=has)
        assert [problem.pointer for problem in caught.value.problems] == ["/physics"]
        assert service.submit(resume_from={"job": job.id}, physics=had)
        assert service.submit(resume_from={"job": job.id})


def test_a_job_goes_on_in_worlds_that_differ_further_but_in_nothing_else(service: Service) -> None:
    friction = {"field": "geom_friction", "range": [0.8, 1.2]}
    job = service.submit(randomization=[friction])
    holding = service.claim(job)
    holding.publish((service.checkpoint(holding, 10),), keep_checkpoints=2)
    further = friction | {"range": [0.4, 1.6]}
    assert service.submit(resume_from={"job": job.id}, randomization=[further, further])
    with pytest.raises(Rejected, match="differ in geom_friction, this job's in nothing") as caught:
        service.submit(resume_from={"job": job.id})
    assert [problem.pointer for problem in caught.value.problems] == ["/randomization"]


@pytest.mark.parametrize(
    ("wanted", "device", "has_checkpoint", "needs"),
    [
        ("any", "NVIDIA H200", True, "gpu"),
        ("any", "cpu × 2", True, "cpu"),
        ("any", "NVIDIA H200", False, "any"),
        ("gpu", "NVIDIA H200", True, "gpu"),
    ],
)
def test_a_job_goes_on_where_its_checkpoint_fits(
    wanted: str, device: str, has_checkpoint: bool, needs: str
) -> None:
    job = make_job(resources={"accelerator": wanted}).claimed("w", NOON).running(device=device)
    if has_checkpoint:
        checkpoint = Artifact(
            name="c", role="checkpoint", media_type="x", key="k", size=1, sha256="0" * 64, step=1
        )
        job = job.next(artifacts=(checkpoint,))
    assert job.accelerator == needs
