"""Which jobs can train together, and which of them a worker takes."""

from datetime import timedelta
from typing import Any

import pytest

from core.adapters.memory.queue import MemoryJobQueue
from core.adapters.postgres.store import PostgresJobStore
from core.jobs.cohort import companions, shape_of
from core.jobs.job import Job
from core.jobs.needs import memory_for
from core.jobs.queue import queue_names
from core.jobs.spec import JOB_SPEC
from core.jobs.submission import submit
from core.jobs.workers import WorkerInfo
from tests.unit.jobs.making import NOON, make_job

TRIAL = {"labels": {"sweep": "s"}}


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ({"seed": 1}, {"seed": 2}),
        ({"name": "a"}, {"name": "b"}),
        ({"algorithm": {"learning_rate": 1e-3}}, {}),
        ({"algorithm": {"entropy_cost": 0.0, "discounting": 0.9}}, {"algorithm": {"gae_lambda": 0.9}}),
        ({"algorithm": {"kind": "sac", "tau": 0.1}}, {"algorithm": {"kind": "sac", "learning_rate": 1e-4}}),
    ],
)
def test_jobs_that_differ_in_numbers_have_one_shape(one: dict[str, Any], other: dict[str, Any]) -> None:
    shape = shape_of(make_job(**one), "gpu")
    assert shape is not None
    assert shape == shape_of(make_job(**other), "gpu")


@pytest.mark.parametrize(
    "other",
    [
        {"algorithm": {"num_envs": 512}},
        {"algorithm": {"num_timesteps": 1_000_000}},
        {"algorithm": {"clipping_epsilon_value": 0.2}},  # A bound where there was none is another program.
        {"environment": {"id": "ant", "options": {"healthy_reward": 2.0}}},
        {"environment": "hopper"},
        {"checkpoints": {"every_steps": 1000}},
        {"video": None},
        {"physics": "native"},
    ],
)
def test_jobs_that_differ_in_anything_else_do_not(other: dict[str, Any]) -> None:
    assert shape_of(make_job(), "gpu") != shape_of(make_job(**other), "gpu")


@pytest.mark.parametrize(
    "said",
    [
        {"resources": {"gpus": 2}},
        {"resume_from": {"job": "019aa3c2f0b1-5be0c1d2e3"}},
        {"kind": "rollout", "policy": {"kind": "zero"}},
        {"environment": "brittle_star", "algorithm": {"kind": "q_learning"}},
    ],
)
def test_these_train_alone(said: dict[str, Any]) -> None:
    assert shape_of(make_job(**said), "gpu") is None


def test_so_does_a_job_that_was_begun_before() -> None:
    begun = make_job().claimed("w", NOON)
    assert shape_of(begun, "gpu") is None


def submitted(store: PostgresJobStore, **said: Any) -> Job:
    spec = JOB_SPEC.validate_python({"kind": "train", "environment": "ant", **TRIAL, **said})
    return submit(spec, store=store, queue=MemoryJobQueue())


def worker(name: str, job: str | None = None, memory_bytes: int | None = None) -> WorkerInfo:
    return WorkerInfo(
        name=name,
        host="host",
        pid=1,
        device="gpu:0",
        queues=queue_names("gpu:0"),
        job=job,
        memory_bytes=memory_bytes,
        started_at=NOON,
        seen_at=NOON,
    )


def test_a_worker_takes_the_trials_of_one_sweep_oldest_first(job_store: PostgresJobStore) -> None:
    first, second, third = (submitted(job_store, seed=seed) for seed in range(3))
    submitted(job_store, seed=1, labels={"sweep": "another"})
    submitted(job_store, seed=1, labels={})
    submitted(job_store, algorithm={"num_envs": 512})
    here = worker("here")
    job_store.announce(here, timedelta(minutes=1))
    assert [one.id for one in companions(first, job_store, "gpu", here, job_store.workers(), 15)] == [
        second.id,
        third.id,
    ]
    assert [one.id for one in companions(first, job_store, "gpu", here, job_store.workers(), 1)] == [
        second.id
    ]
    assert companions(first, job_store, "gpu", here, job_store.workers(), 0) == []


def test_it_leaves_their_share_to_workers_that_are_free(job_store: PostgresJobStore) -> None:
    first, *_ = (submitted(job_store, seed=seed) for seed in range(6))
    here = worker("here")
    for one in (here, worker("free"), worker("busy", job="another")):
        job_store.announce(one, timedelta(minutes=1))
    assert (
        len(companions(first, job_store, "gpu", here, job_store.workers(), 15)) == 2
    )  # Three of six, and the first is one.


def test_it_takes_no_more_than_fit_into_its_memory(job_store: PostgresJobStore) -> None:
    # 15 % of the memory is what three of them need for certain, and a little.
    first, *_ = (submitted(job_store, seed=seed) for seed in range(6))
    needed = memory_for(first.spec)["gpu"].bytes
    here = worker("here", memory_bytes=21 * needed)
    job_store.announce(here, timedelta(minutes=1))
    assert len(companions(first, job_store, "gpu", here, job_store.workers(), 15)) == 2
