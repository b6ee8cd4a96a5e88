"""Submitting, claiming, cancelling, losing: the use cases over the record."""

import re
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta
from typing import Any

import pytest
from sqlalchemy import event, text

from core.adapters.postgres.engine import connect_postgres
from core.adapters.postgres.store import PostgresJobStore
from core.clips.record import ClipFacts, ClipsDescription
from core.errors import (
    IdempotencyKeyReused,
    JobFinished,
    JobInUse,
    JobNotFinished,
    JobNotFound,
    JobUnreadable,
    LeaseLost,
    RecordsUnavailable,
    Rejected,
    StorageUnavailable,
)
from core.jobs.attempts import Claim, claim_attempt, new_secret
from core.jobs.ending import cancel, delete, end_deletions
from core.jobs.job import Artifact, Job
from core.jobs.reconciliation import Reconciler
from core.jobs.spec import JOB_SPEC, RecordingSpec, RolloutSpec, Source
from core.jobs.status import JobStatus
from core.jobs.store import Idempotency, JobQuery
from core.jobs.submission import Acknowledgements, submit
from core.reasons import Reason
from core.storage import keys
from core.user_models.record import ModelRecord
from tests.contract.recording import clip_file
from tests.feeds import read_feed
from tests.in_memory import MemoryJobQueue, MemoryObjectStore
from tests.unit.jobs.making import NOON, make_job

LEASE = timedelta(seconds=10)
MODEL = "sha256:" + "0" * 64


class Away(MemoryJobQueue):
    """A queue that nobody reaches."""

    def enqueue(self, *_: object, **__: object) -> None:
        raise RecordsUnavailable("away")


class Service:
    """The record, a queue, and a clock that tests move."""

    def __init__(self, database_url: str) -> None:
        self.engine = connect_postgres(database_url)
        self.store = PostgresJobStore(self.engine)
        self.queue = MemoryJobQueue()
        self.objects = MemoryObjectStore()
        self.reconciler = Reconciler(self.store, self.queue, LEASE)

    def submit(self, idempotency: Idempotency | None = None, **fields: Any) -> Job:
        spec = JOB_SPEC.validate_python({"kind": "train", "environment": "ant", **fields})
        heard = Acknowledgements(self.store.dispatched).add_at_once
        return submit(spec, store=self.store, queue=self.queue, idempotency=idempotency, acknowledge=heard)

    def claim(self, job: Job) -> Claim:
        self.queue.take()
        claim = self.try_to_claim(job, self.store.get(job.id).next_attempt)
        assert claim is not None
        return claim

    def try_to_claim(self, job: Job, number: int) -> Claim | None:
        return claim_attempt(
            job.id, number, "w", store=self.store, objects=self.objects, lease=LEASE, secret=new_secret()
        )

    def cancel(self, job: Job) -> Job:
        return cancel(job.id, store=self.store, queue=self.queue)

    def delete(self, job: Job) -> None:
        delete(job.id, store=self.store, objects=self.objects)

    def reconcile(self) -> int:
        """A look of a reconciler that has been looking all the time."""
        self.have_watched()
        return self.reconciler.run_once()

    def have_watched(self) -> None:
        """As if a reconciler had been looking all the time."""
        self._execute("UPDATE pulse SET beat_at = clock_timestamp(), quiet_until = '2026-01-01'")

    def fall_silent(self, span: timedelta) -> None:
        """Since the last look of a reconciler, so much time has passed."""
        self._execute(
            "UPDATE pulse SET beat_at = clock_timestamp() - :s * interval '1 second'", s=span.total_seconds()
        )

    def damage(self, job: Job) -> None:
        """Nobody can read its specification any more."""
        self._execute("UPDATE jobs SET spec = '{' WHERE id = :id", id=job.id)

    def wait(self, seconds: float) -> None:
        """To the leases, so much time has passed."""
        self._execute("UPDATE jobs SET lease_until = lease_until - :s * interval '1 second'", s=seconds)

    def jobs(self) -> list[str]:
        return [job.id for job in self.store.list(JobQuery()).jobs]

    def status(self, job: Job) -> JobStatus:
        return self.store.get(job.id).status

    def checkpoint(self, claim: Claim, step: int) -> Artifact:
        name = f"checkpoint-{step:012d}.msgpack"
        key = keys.artifact(claim.job_id, claim.number, "0" * 64, name)
        self.objects.put(key, b"state")
        return Artifact(name=name, role="checkpoint", media_type="", size=5, sha256="", key=key, step=step)

    def _execute(self, statement: str, **values: float | str) -> None:
        with self.engine.begin() as connection:
            connection.execute(text(statement), values)


@pytest.fixture
def service(database_url: str) -> Iterator[Service]:
    service = Service(database_url)
    yield service
    service.store.close()


def test_a_submission_is_recorded_and_dispatched(service: Service) -> None:
    job = service.submit()
    assert service.store.get(job.id) == job
    assert service.queue.contains(job.id, 1)
    assert service.store.undispatched() == []


def test_a_submission_while_the_queue_is_away_is_dispatched_later(service: Service) -> None:
    queue, service.queue = service.queue, Away()
    job = service.submit()
    assert not queue.contains(job.id, 1)
    assert service.reconcile() == 1
    assert queue.contains(job.id, 1)
    assert service.reconcile() == 0


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
    assert service.jobs() == []
    assert service.queue.take() is None


def test_the_same_key_makes_one_job_and_another_body_under_it_is_refused(service: Service) -> None:
    first = service.submit(Idempotency("key", "body"))
    assert service.submit(Idempotency("key", "body")).id == first.id
    with pytest.raises(IdempotencyKeyReused):
        service.submit(Idempotency("key", "other body"))
    assert service.jobs() == [first.id]


def test_a_dispatch_is_claimed_once(service: Service) -> None:
    job = service.submit()
    service.claim(job)
    assert service.try_to_claim(job, 1) is None
    assert service.try_to_claim(job, 2) is None


def test_a_claim_whose_answer_was_lost_finds_what_it_took(service: Service) -> None:
    job, secret = service.submit(), new_secret()

    def take() -> Claim | None:
        return claim_attempt(
            job.id, 1, "w", store=service.store, objects=service.objects, lease=LEASE, secret=secret
        )

    first = take()
    assert first is not None
    assert take() == first
    assert len(service.store.get(job.id).attempts) == 1


def test_a_queued_job_is_cancelled_at_once_and_a_running_one_is_asked(service: Service) -> None:
    queued, running = service.submit(), service.submit()
    assert service.cancel(queued).status == JobStatus.CANCELLED
    assert not service.queue.contains(queued.id, 1)
    claim = service.claim(running)
    claim.start(device="cpu")
    assert service.cancel(running).status == JobStatus.CANCELLING
    assert service.cancel(running).status == JobStatus.CANCELLING
    claim.end(JobStatus.CANCELLED, Reason.USER_CANCELLED, "")
    assert service.cancel(running).reason == Reason.USER_CANCELLED


def test_what_has_succeeded_cannot_be_cancelled(service: Service) -> None:
    job = service.submit()
    service.claim(job).end(JobStatus.SUCCEEDED, Reason.COMPLETED, "")
    with pytest.raises(JobFinished):
        service.cancel(job)


def test_a_cancel_that_comes_before_the_start_is_not_lost(service: Service) -> None:
    job = service.submit()
    claim = service.claim(job)
    service.cancel(job)
    assert claim.start(device="cpu").status == JobStatus.CANCELLING


def test_a_job_that_the_queue_forgot_is_dispatched_again(service: Service) -> None:
    job = service.submit()
    service.queue.remove(job.id, 1)
    # A worker may be just taking it: only what two looks miss has been forgotten.
    assert service.reconcile() == 0
    assert service.reconcile() == 1
    assert service.queue.contains(job.id, 1)
    assert service.reconcile() == 0


def test_a_silent_worker_loses_its_job_and_its_late_writes_change_nothing(service: Service) -> None:
    job = service.submit()
    claim = service.claim(job)
    service.wait(9)
    assert service.reconcile() == 0
    service.wait(2)
    assert service.reconcile() == 1
    taken = service.store.get(job.id)
    assert (taken.status, taken.attempts[0].reason) == (JobStatus.QUEUED, Reason.WORKER_LOST)
    with pytest.raises(LeaseLost):
        claim.end(JobStatus.SUCCEEDED, Reason.COMPLETED, "")
    assert service.store.get(job.id) == taken


def test_when_all_attempts_are_lost_the_job_has_failed(service: Service) -> None:
    job = service.submit(max_attempts=2)
    for attempt in (1, 2):
        service.claim(job)
        service.wait(100)
        assert service.reconcile() == 1, attempt
    lost = service.store.get(job.id)
    assert (lost.status, lost.reason) == (JobStatus.FAILED, Reason.WORKER_LOST)
    assert "All 2 attempts" in (lost.message or "")


def test_a_drained_attempt_does_not_count(service: Service) -> None:
    job = service.submit(max_attempts=1)
    service.claim(job).give_back(Reason.WORKER_DRAINED, "")
    assert service.status(job) == JobStatus.QUEUED


def test_a_worker_lost_while_cancelling_leaves_a_cancelled_job(service: Service) -> None:
    job = service.submit()
    service.claim(job)
    service.cancel(job)
    service.wait(100)
    service.reconcile()
    assert service.status(job) == JobStatus.CANCELLED


def test_only_the_newest_checkpoints_are_kept_and_the_others_may_be_removed(service: Service) -> None:
    claim = service.claim(service.submit())
    for step in (10, 20, 30):
        job, dropped = claim.publish((service.checkpoint(claim, step),), keep_checkpoints=2)
    assert [a.step for a in job.artifacts] == [20, 30]
    assert [key.rpartition("/")[2] for key in dropped] == ["checkpoint-000000000010.msgpack"]


def test_a_checkpoint_that_a_queued_job_was_promised_is_kept(service: Service) -> None:
    source = service.submit()
    claim = service.claim(source)
    claim.publish((service.checkpoint(claim, 10),), keep_checkpoints=1)
    borrower = service.submit(resume_from={"job": source.id, "step": 10})
    job, dropped = claim.publish((service.checkpoint(claim, 20),), keep_checkpoints=1)
    assert ([a.step for a in job.artifacts], dropped) == ([10, 20], [])
    claim.end(JobStatus.SUCCEEDED, Reason.COMPLETED, "")
    with pytest.raises(JobInUse, match=borrower.id):
        service.delete(source)
    service.cancel(borrower)
    service.delete(source)


def test_what_ended_stays_as_it_is_when_the_queue_is_emptied(service: Service) -> None:
    queued, running, done, cancelled = (service.submit() for _ in range(4))
    for job in (queued, running, done, cancelled):
        service.queue.remove(job.id, 1)
    service.try_to_claim(running, 1)
    held = service.try_to_claim(done, 1)
    assert held is not None
    held.end(JobStatus.SUCCEEDED, Reason.COMPLETED, "")
    service.cancel(cancelled)
    before = [service.store.get(job.id) for job in (queued, running, done, cancelled)]
    assert [service.reconcile(), service.reconcile(), service.reconcile()] == [0, 1, 0]
    assert [service.store.get(job.id) for job in before] == before
    assert [dispatch.job_id for dispatch in service.queue.waiting()] == [queued.id]


def test_only_a_job_that_has_ended_is_deleted_and_then_nothing_is_left(service: Service) -> None:
    job = service.submit()
    with pytest.raises(JobNotFinished):
        service.delete(job)
    service.cancel(job)
    service.delete(job)
    assert list(service.objects.list("")) == []
    with pytest.raises(JobNotFound):
        service.store.get(job.id)


def test_a_rollout_needs_a_job_with_a_checkpoint_in_the_same_environment(service: Service) -> None:
    job = service.submit()
    policy = {"kind": "checkpoint", "job": job.id}

    def roll_out(environment: str) -> Job:
        spec = JOB_SPEC.validate_python({"kind": "rollout", "environment": environment, "policy": policy})
        return submit(spec, store=service.store, queue=service.queue)

    with pytest.raises(Rejected, match="no checkpoint"):
        roll_out("ant")
    claim = service.claim(job)
    claim.publish((service.checkpoint(claim, 10),), keep_checkpoints=2)
    assert roll_out("ant").spec.kind == "rollout"
    with pytest.raises(Rejected, match=r"must be the same.*Leave `environment` out"):
        roll_out("hopper")


def test_a_rollout_of_the_best_policy_needs_a_job_that_was_evaluated(service: Service) -> None:
    job = service.submit()
    policy = {"kind": "checkpoint", "job": job.id, "which": "best"}
    spec = JOB_SPEC.validate_python({"kind": "rollout", "policy": policy})
    claim = service.claim(job)
    checkpoint = service.checkpoint(claim, 10)
    claim.publish((checkpoint,), keep_checkpoints=2)
    with pytest.raises(Rejected, match="has no best policy: either it has not been evaluated yet") as refused:
        submit(spec, store=service.store, queue=service.queue)
    assert [problem.pointer for problem in refused.value.problems] == ["/policy/which"]
    best = checkpoint.model_copy(update={"name": "policy-best", "role": "best_policy"})
    claim.publish((best,), keep_checkpoints=2)
    rollout = submit(spec, store=service.store, queue=service.queue)
    assert rollout.spec.source == Source(job.id, None, "/policy", is_best=True)


def test_a_rollout_of_a_checkpoint_takes_the_jobs_own_environment_where_it_names_none(
    service: Service,
) -> None:
    chosen = {"id": "ant", "options": {"healthy_reward": 0.5}}
    job = service.submit(environment=chosen)
    claim = service.claim(job)
    claim.publish((service.checkpoint(claim, 10),), keep_checkpoints=2)
    spec = JOB_SPEC.validate_python({"kind": "rollout", "policy": {"kind": "checkpoint", "job": job.id}})
    rollout = submit(spec, store=service.store, queue=service.queue)
    assert service.store.get(rollout.id).spec.environment.model_dump() == chosen
    unknown = {"kind": "rollout", "policy": {"kind": "checkpoint", "job": "019aa3c2f0b1-5be0c1d2e3"}}
    with pytest.raises(Rejected, match="There is no job") as refused:
        submit(JOB_SPEC.validate_python(unknown), store=service.store, queue=service.queue)
    assert [problem.pointer for problem in refused.value.problems] == ["/policy/job"]


def test_a_rollout_may_lay_the_arena_out_anew_and_change_nothing_that_the_policy_sees(
    service: Service,
) -> None:
    trained = {"id": "corridor", "options": {"arena_seed": 1, "num_layouts": 8, "num_next_obstacles": 2}}
    job = service.submit(environment=trained)
    claim = service.claim(job)
    claim.publish((service.checkpoint(claim, 10),), keep_checkpoints=2)

    def roll_out(kind: str = "rollout", **options: Any) -> Job:
        environment = {"id": "corridor", "options": {"num_next_obstacles": 2, **options}}
        source = "policy" if kind == "rollout" else "resume_from"
        given = {"job": job.id} | ({"kind": "checkpoint"} if kind == "rollout" else {})
        spec = JOB_SPEC.validate_python({"kind": kind, "environment": environment, source: given})
        return submit(spec, store=service.store, queue=service.queue)

    assert roll_out(arena_seed=99, num_layouts=2, gap_length=[0.1, 0.3]).spec.kind == "rollout"
    with pytest.raises(Rejected, match="must be the same except in arena, corridor_length, "):
        roll_out(num_next_obstacles=3)
    with pytest.raises(Rejected, match="must be the same except"):
        roll_out(walker="rodent")
    with pytest.raises(Rejected, match=r"must be the same\."):
        roll_out(kind="train", arena_seed=99)
    # An action of 0 used to mean another pose for a humanoid. An older policy still needs that pose.
    assert roll_out(zero_action="middle").spec.kind == "rollout"


@pytest.mark.parametrize("body", ["g1", "humanoid", "rodent"])
def test_a_rollout_follows_other_clips_that_its_policy_sees_as_before(service: Service, body: str) -> None:
    walk = ClipFacts(name="walk", num_frames=51, rate=50.0, seconds=1.0)
    found = ClipsDescription(format="csv", clips=[walk], joints=[])
    files = [f"sha256:{digit * 64}" for digit in "12"]
    for file in files:
        service.store.clips.add(clip_file(file, body=body, description=found))

    def follow(file: str, **reference: Any) -> dict[str, Any]:
        options = {"task": "imitate", "reference": {"clips": [{"file": file}], **reference}}
        return {"environment": {"id": body, "options": options}}

    job = service.submit(**follow(files[0]))
    claim = service.claim(job)
    claim.publish((service.checkpoint(claim, 10),), keep_checkpoints=2)
    rollout = {"kind": "rollout", "policy": {"kind": "checkpoint", "job": job.id}}
    service.submit(**rollout, **follow(files[1], random_phase=0.0))
    for changed in ({"ahead": {"frames": 5}}, {"ahead": {"every_s": 0.02}}, {"bodies": ["pelvis"]}):
        with pytest.raises(Rejected, match=f"differ at /environment/options/reference/{next(iter(changed))}"):
            service.submit(**rollout, **follow(files[1], **changed))


def test_a_recording_names_layers_that_the_policy_has_and_is_not_too_large(service: Service) -> None:
    job = service.submit()
    claim = service.claim(job)
    used = {"kind": "ppo", "policy_hidden_layer_sizes": [8, 2048]}
    claim.start(device="cpu", details={"hyperparameters": used})
    claim.publish((service.checkpoint(claim, 10),), keep_checkpoints=2)
    of_the_job = {"kind": "checkpoint", "job": job.id}

    def record(recording: Any, policy: Any = of_the_job, **fields: Any) -> Job:
        document = {"kind": "rollout", "environment": "ant", "policy": policy, "recording": recording}
        return submit(JOB_SPEC.validate_python(document | fields), store=service.store, queue=service.queue)

    accepted = record({"layers": ["policy/[01]"]}).spec
    assert isinstance(accepted, RolloutSpec)
    assert accepted.recording == RecordingSpec(layers=["policy/[01]"])
    assert record(True, {"kind": "random"}).spec.kind == "rollout"
    refused: list[tuple[Callable[[], Job], str, list[str]]] = [
        (
            lambda: record({"layers": ["policy/.*", "encoder/0"]}),
            "No layer of the policy is called 'encoder/0'. It has policy/0, policy/1, policy/2.",
            ["/recording/layers/1"],
        ),
        # 1,000,000 steps of 4 bytes × 2,048 are 8.2 GB already.
        (
            lambda: record(True, num_steps=100_000, num_episodes=10),
            "At most 4 GB are allowed: record fewer layers, steps or episodes.",
            ["/recording/layers", "/num_steps", "/num_episodes"],
        ),
        (
            lambda: record({"layers": ["policy/0"]}, {"kind": "random"}),
            "a policy of the kind `random` has none: leave `layers` out.",
            ["/recording/layers"],
        ),
    ]
    for asks, sentence, places in refused:
        with pytest.raises(Rejected, match=re.escape(sentence)) as caught:
            asks()
        assert [problem.pointer for problem in caught.value.problems] == places
    # Without the layer that makes it large, it fits.
    assert record({"layers": ["policy/0"]}, num_steps=100_000, num_episodes=10).spec.kind == "rollout"


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
        submit(spec, store=service.store, queue=service.queue)
    assert [problem.pointer for problem in caught.value.problems] == ["/num_steps", "/num_episodes"]


@pytest.mark.parametrize(
    ("fields", "sentence", "pointers"),
    [
        (
            {"resources": {"accelerator": "cpu", "gpus": 2}},
            "The job asks for 2 GPUs, but its accelerator is `cpu`",
            ["/resources/accelerator", "/resources/gpus"],
        ),
        (
            {"kind": "rollout", "policy": {"kind": "zero"}, "resources": {"gpus": 2}},
            "A rollout runs on one GPU, but the job asks for 2",
            ["/resources/gpus"],
        ),
        (
            {"resources": {"gpus": 65}},
            "65 GPUs are more than 64 on each host",
            ["/resources/gpus"],
        ),
        (
            {"resources": {"gpus": 3, "hosts": 2}},
            "gpus = 3 is the number on all hosts together, and no multiple of hosts = 2",
            ["/resources/gpus", "/resources/hosts"],
        ),
        (
            {"resources": {"hosts": 2}},
            "A job on 2 hosts must say what it needs there",
            ["/resources/hosts"],
        ),
        (
            {"kind": "rollout", "policy": {"kind": "zero"}, "resources": {"gpus": 2, "hosts": 2}},
            "A rollout runs on one host, but the job asks for 2",
            ["/resources/hosts"],
        ),
        (
            {"resources": {"share_gpu": True, "accelerator": "cpu"}},
            "The job shares a GPU, but its accelerator is `cpu`",
            ["/resources/accelerator", "/resources/share_gpu"],
        ),
        (
            {"resources": {"share_gpu": True, "gpus": 2}},
            "Only a job on one GPU can share it, and this one asks for several gpus",
            ["/resources/share_gpu", "/resources/gpus"],
        ),
        (
            {"resources": {"gpu_memory_gib": 2}},
            "`gpu_memory_gib` is for a job that shares a GPU: set `share_gpu`",
            ["/resources/gpu_memory_gib"],
        ),
        (
            {
                "resources": {"share_gpu": True, "gpu_memory_gib": 1},
                "algorithm": {"policy_hidden_layer_sizes": [8192] * 8},
            },
            "but the part of a GPU that it asks for has 1 GiB",
            ["/resources/gpu_memory_gib"],
        ),
        (
            {"resources": {"gpus": 2, "hosts": 2}, "algorithm": {"kind": "sac"}},
            "sac runs on one host, but the job asks for 2",
            ["/resources/hosts"],
        ),
        (
            {"resources": {"accelerator": "cpu", "hosts": 2}, "seeds": [1, 2]},
            "Several seeds are trained on one device, but the job asks for 2 hosts",
            ["/seeds", "/resources/hosts"],
        ),
        (
            {
                "resources": {"accelerator": "cpu", "hosts": 3},
                "algorithm": {"num_envs": 8, "batch_size": 6, "num_minibatches": 4},
            },
            "num_envs = 8 is not a multiple of the 3 devices",
            ["/algorithm/num_envs"],
        ),
        (
            # 6 × 4 = 24 unrolls of 8 environments go together, but neither 6 nor 8 are shared by four or
            # three.
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
def test_devices_that_cannot_share_a_job_are_refused_with_the_places(
    fields: dict[str, Any], sentence: str, pointers: list[str], service: Service
) -> None:
    spec = JOB_SPEC.validate_python({"kind": "train", "environment": "ant", **fields})
    with pytest.raises(Rejected, match=sentence) as caught:
        submit(spec, store=service.store, queue=service.queue)
    assert [problem.pointer for problem in caught.value.problems] == pointers


def test_only_workers_of_as_many_hosts_take_a_job_for_several(service: Service) -> None:
    job = service.submit(resources={"gpus": 4, "hosts": 2})
    service.queue.remove(job.id, 1)
    service.reconcile()
    service.reconcile()
    assert service.queue.take("gpu:0-3") is service.queue.take("gpu:0,1") is None
    assert service.queue.take("gpu:0-3", hosts=2) is service.queue.take("cpu", hosts=2) is None
    dispatch = service.queue.take("gpu:0,1", hosts=2)
    assert dispatch is not None
    assert (dispatch.job_id, dispatch.attempt) == (job.id, 1)


def test_a_job_for_two_gpus_waits_for_them_however_often_it_is_dispatched(service: Service) -> None:
    job = service.submit(resources={"gpus": 2})
    assert (job.accelerator, service.queue.take("cpu"), service.queue.take("gpu:0")) == ("gpu", None, None)
    service.queue.remove(job.id, 1)  # as an emptied Redis does
    service.reconcile()
    service.reconcile()
    dispatch = service.queue.take("gpu:0,1")
    assert dispatch is not None
    assert dispatch.job_id == job.id


def test_a_job_of_another_shape_cannot_go_on_from_a_checkpoint(service: Service) -> None:
    job = service.submit()
    claim = service.claim(job)
    claim.start(device="cpu", details={"hyperparameters": {"kind": "ppo", "num_envs": 64}})
    claim.publish((service.checkpoint(claim, 10),), keep_checkpoints=2)
    with pytest.raises(Rejected, match="made with num_envs = 64; this job has 256") as caught:
        service.submit(resume_from={"job": job.id}, resources={"accelerator": "cpu"})
    assert "/algorithm/num_envs" in [problem.pointer for problem in caught.value.problems]


def test_a_job_whose_budget_the_checkpoint_has_reached_is_refused(service: Service) -> None:
    job = service.submit()
    claim = service.claim(job)
    claim.publish((service.checkpoint(claim, 3_000), service.checkpoint(claim, 2_000)), keep_checkpoints=2)

    def asks(num_timesteps: int, **point: Any) -> Job:
        algorithm = {"kind": "ppo", "num_timesteps": num_timesteps}
        return service.submit(algorithm=algorithm, resume_from={"job": job.id, **point})

    for refused in (lambda: asks(3_000), lambda: asks(2_000, step=2_000)):
        with pytest.raises(Rejected, match="nothing is left to train") as caught:
            refused()
        assert [problem.pointer for problem in caught.value.problems] == ["/algorithm", "/resume_from"]
    assert asks(3_001)
    assert asks(3_000, step=2_000)


def test_a_job_cannot_go_on_from_environments_of_warp_on_another_engine_nor_the_other_way_round(
    service: Service,
) -> None:
    for had, has in (("warp", "mjx"), ("native", "warp"), ("warp", "compiled"), ("compiled", "warp")):
        job = service.submit()
        claim = service.claim(job)
        claim.start(device="NVIDIA H200", engine=had, details={})
        claim.publish((service.checkpoint(claim, 10),), keep_checkpoints=2)
        with pytest.raises(Rejected, match=f"states of the engine {had}, and a run on {has}") as caught:
            service.submit(resume_from={"job": job.id}, physics=has)
        assert [problem.pointer for problem in caught.value.problems] == ["/physics"]
        assert service.submit(resume_from={"job": job.id}, physics=had)
        assert service.submit(resume_from={"job": job.id})


@pytest.mark.parametrize(("had", "has"), [("native", "compiled"), ("compiled", "mjx")])
def test_a_job_may_go_on_from_environments_of_another_engine_whose_states_have_the_same_fields(
    had: str, has: str, service: Service
) -> None:
    job = service.submit()
    claim = service.claim(job)
    claim.start(device="cpu", engine=had, details={})
    claim.publish((service.checkpoint(claim, 10),), keep_checkpoints=2)
    assert service.submit(resume_from={"job": job.id}, physics=has)


def test_a_job_goes_on_in_environments_that_differ_further_but_in_nothing_else(service: Service) -> None:
    friction = {"field": "geom_friction", "range": [0.8, 1.2]}
    job = service.submit(randomization=[friction])
    claim = service.claim(job)
    claim.publish((service.checkpoint(claim, 10),), keep_checkpoints=2)
    further = friction | {"range": [0.4, 1.6]}
    assert service.submit(resume_from={"job": job.id}, randomization=[further, further])
    with pytest.raises(Rejected, match="randomizes geom_friction, this one nothing") as caught:
        service.submit(resume_from={"job": job.id})
    assert [problem.pointer for problem in caught.value.problems] == ["/randomization"]
    with pytest.raises(Rejected, match="Only one of this job and the checkpoint's has a rule with `every_s`"):
        service.submit(resume_from={"job": job.id}, randomization=[friction | {"every_s": 5.0}])


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


def test_after_a_silence_of_the_reconciler_an_attempt_has_a_lease_to_speak(service: Service) -> None:
    job = service.submit()
    claim = service.claim(job)
    service.wait(100)
    # Nobody looked meanwhile, or the record was away: the attempt could not have renewed its lease.
    service.fall_silent(LEASE)
    assert service.reconciler.run_once() == 0
    claim.store.renew(job.id, claim.token, LEASE)
    assert service.reconcile() == 0
    assert claim.end(JobStatus.SUCCEEDED, Reason.COMPLETED, "").status == JobStatus.SUCCEEDED


def test_two_reconcilers_at_once_take_a_job_back_once(service: Service) -> None:
    held = [service.submit() for _ in range(10)]
    for job in held:
        service.claim(job)
    service.wait(100)
    service.have_watched()
    another = Reconciler(service.store, service.queue, LEASE)
    together = threading.Barrier(2)

    def look(reconciler: Reconciler) -> None:
        together.wait()
        reconciler.run_once()

    with ThreadPoolExecutor(2) as pool:
        for done in [pool.submit(look, one) for one in (service.reconciler, another)]:
            done.result(60)
    for job in held:
        taken = service.store.get(job.id)
        assert (taken.status, len(taken.attempts), taken.version) == (JobStatus.QUEUED, 1, 3)
        assert service.queue.contains(job.id, 2)


def test_a_model_that_the_queue_was_not_told_of_or_forgot_is_handed_over(service: Service) -> None:
    record = ModelRecord(id=MODEL, status="validating", media_type="", size=1, created_at=NOON)
    service.store.models.add(record)
    assert service.reconcile() == 1
    assert service.queue.take_upload() == ("model", MODEL)
    assert (service.reconcile(), service.reconcile()) == (0, 1)
    assert service.queue.take_upload() == ("model", MODEL)
    service.store.models.settle(record.model_copy(update={"status": "ready"}))
    assert (service.reconcile(), service.reconcile()) == (0, 0)


def test_an_unreadable_job_keeps_no_other_from_being_dispatched(service: Service) -> None:
    queue, service.queue = service.queue, Away()
    first, damaged, last = (service.submit() for _ in range(3))
    service.damage(damaged)
    assert service.reconcile() == 2
    assert [dispatch.job_id for dispatch in queue.waiting()] == [first.id, last.id]
    assert service.store.undispatched() == []


def test_a_queue_that_goes_away_in_the_midst_gets_the_rest_later(service: Service) -> None:
    queue, service.queue = service.queue, Away()
    submitted = [service.submit() for _ in range(3)]
    service.reconciler = Reconciler(service.store, Away(), LEASE)
    assert service.reconcile() == 0
    assert len(service.store.undispatched()) == 3
    service.reconciler = Reconciler(service.store, queue, LEASE)
    assert service.reconcile() == 3
    assert [dispatch.job_id for dispatch in queue.waiting()] == [job.id for job in submitted]


def test_an_unreadable_job_is_not_cancelled_and_deleted_once_it_has_ended(service: Service) -> None:
    waiting, ended = service.submit(), service.submit()
    service.cancel(ended)
    for job in (waiting, ended):
        service.damage(job)
        with pytest.raises(JobUnreadable):
            service.cancel(job)
    with pytest.raises(JobNotFinished):
        service.delete(waiting)
    service.delete(ended)
    assert service.jobs() == [waiting.id]


def test_what_a_deletion_leaves_in_an_outage_is_shown_to_nobody_and_removed_later(service: Service) -> None:
    """M12: the record goes first; the reconciler removes the objects when the store is back."""

    class Frail(MemoryObjectStore):
        def delete_prefix(self, prefix: str) -> None:
            raise StorageUnavailable("away")

    job = service.submit()
    claim = service.claim(job)
    claim.publish((service.checkpoint(claim, 10),), keep_checkpoints=2)
    service.objects.put(f"{keys.job(job.id)}a-file", b"x")
    claim.end(JobStatus.SUCCEEDED, Reason.COMPLETED, "")
    whole, service.objects = service.objects, Frail()
    service.delete(job)
    with pytest.raises(JobNotFound):
        service.status(job)
    with pytest.raises(JobNotFound):
        read_feed(job.id, "events", store=service.store, objects=whole)
    with pytest.raises(Rejected, match="no job"):
        service.submit(resume_from={"job": job.id})
    with pytest.raises(StorageUnavailable):
        end_deletions(store=service.store, objects=service.objects, after=timedelta(0))
    assert list(whole.list("")) != []
    assert end_deletions(store=service.store, objects=whole) == 0
    assert end_deletions(store=service.store, objects=whole, after=timedelta(0)) == 1
    assert (service.jobs(), list(whole.list("")), service.store.deletions()) == ([], [], [])


def test_a_job_is_not_deleted_between_the_check_and_the_end_of_a_submission_that_needs_it(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    """M12: either the resumption is refused, or the deletion."""
    source = service.submit()
    claim = service.claim(source)
    claim.publish((service.checkpoint(claim, 10),), keep_checkpoints=2)
    claim.end(JobStatus.SUCCEEDED, Reason.COMPLETED, "")
    add = service.store.add

    def delete_first(*arguments: Any) -> Job:
        monkeypatch.undo()
        service.delete(source)
        return add(*arguments)

    monkeypatch.setattr(service.store, "add", delete_first)
    with pytest.raises(Rejected) as refused:
        service.submit(resume_from={"job": source.id})
    assert [problem.pointer for problem in refused.value.problems] == ["/resume_from/job"]


def test_the_queue_gets_only_as_many_jobs_as_workers_take_soon_and_each_has_its_turn(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    """H4: the record holds the rest, so that no number of submissions fills Redis."""
    monkeypatch.setattr("core.jobs.submission.MOST_SUBMITTED", 2)
    monkeypatch.setattr("core.jobs.reconciliation.MOST_WAITING", 4)
    normal = [service.submit() for _ in range(7)]
    urgent = service.submit(priority="high")

    def waiting() -> list[str]:
        return [dispatch.job_id for dispatch in service.queue.waiting()]

    assert waiting() == [normal[0].id, normal[1].id, urgent.id]
    assert service.reconcile() == 2
    assert sorted(waiting()) == sorted(job.id for job in (*normal[:4], urgent))
    assert service.reconcile() == 0
    for expected in (urgent, normal[0]):
        taken = service.queue.take()
        assert taken is not None
        assert taken.job_id == expected.id
        assert service.try_to_claim(expected, 1) is not None
    late = service.submit()
    assert service.reconcile() == 1
    assert waiting() == [job.id for job in normal[1:5]]
    left = [dispatch.subject for dispatch in service.store.undispatched()]
    assert left == [normal[5].id, normal[6].id, late.id]


def test_after_redis_was_emptied_each_look_hands_over_a_part_and_beats(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    """M6: in one look of all, no lease was watched for minutes."""
    monkeypatch.setattr("core.jobs.reconciliation._AT_ONCE", 3)
    jobs = [service.submit() for _ in range(7)]
    for job in jobs:
        service.queue.remove(job.id, 1)
    beats: list[timedelta] = []
    monkeypatch.setattr(service.store, "beat", beats.append)
    assert [service.reconcile() for _ in range(5)] == [0, 3, 3, 1, 0]
    assert len(beats) == 5
    assert [dispatch.job_id for dispatch in service.queue.waiting()] == [job.id for job in jobs]


def test_a_look_reads_what_it_hands_over_at_once(service: Service) -> None:
    """M6: however many jobs there are, it asks the record as often."""
    asked: list[str] = []
    event.listen(service.engine, "before_cursor_execute", lambda *said: asked.append(said[2]))
    counts: list[int] = []
    for number in (2, 20):
        for _ in range(number):
            service.queue.remove(service.submit().id, 1)
        service.reconcile()
        asked.clear()
        assert service.reconcile() == number
        counts.append(len(asked))
    assert counts[0] == counts[1]
