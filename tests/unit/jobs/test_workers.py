"""A job that no worker could take says so; one that another worker can run is left to it."""

from dataclasses import replace
from typing import Any

import pytest

from core.environments import catalog
from core.jobs.job import Artifact
from core.jobs.queue import queue_names
from core.jobs.workers import WorkerInfo, WorkerState, packages_here, what_it_waits_for, why_left_to_others
from core.reasons import Reason
from tests.unit.jobs.making import NOON, make_job


def worker(device: str, state: WorkerState = "ready", hosts: int = 1, **has: Any) -> WorkerInfo:
    said = {
        "problem": f"A test of the device {device} failed." if state == "device_failed" else None,
        "queues": queue_names(device, hosts),
    }
    return WorkerInfo(
        **{**said, **has},
        name=f"host:{device}",
        hosts=hosts,
        host="host",
        pid=1,
        device=device,
        state=state,
        started_at=NOON,
        seen_at=NOON,
    )


@pytest.mark.parametrize(
    ("resources", "devices", "sentence"),
    [
        ({}, ["cpu"], None),
        ({}, ["gpu:1"], None),
        ({"accelerator": "gpu"}, ["cpu", "gpu:0"], None),
        ({"gpus": 2}, ["cpu", "gpu:0,1"], None),
        ({"gpus": 1}, ["cpu"], "No worker has exactly one GPU: the workers here have cpu."),
        ({"gpus": 1}, ["gpu:0"], None),
        ({"gpus": 1, "accelerator": "cpu"}, ["cpu"], None),
        (
            {"gpus": 4},
            ["gpu:0", "cpu", "cpu", "gpu:0,1"],
            "No worker has exactly 4 GPUs: the workers here have cpu, gpu:0, gpu:0,1.",
        ),
        (
            {"accelerator": "gpu"},
            ["cpu", "gpu:0,1"],
            "No worker has exactly one GPU: the workers here have cpu, gpu:0,1.",
        ),
        ({"accelerator": "cpu"}, ["gpu:0"], "No worker has a CPU: the workers here have gpu:0."),
        ({}, [], "No worker has one GPU or a CPU: no worker is running."),
    ],
)
def test_a_queued_job_says_what_no_worker_has(
    resources: dict[str, object], devices: list[str], sentence: str | None
) -> None:
    job = make_job(resources=resources)
    assert what_it_waits_for(job, [worker(device) for device in devices]) == sentence


def test_devices_that_were_set_aside_are_named_unless_another_worker_fits() -> None:
    job, failed = make_job(resources={"accelerator": "gpu"}), worker("gpu:0", "device_failed")
    assert what_it_waits_for(job, [worker("cpu"), failed]) == (
        "The device of each suitable worker was set aside: host:gpu:0: A test of the device gpu:0 failed."
    )
    assert what_it_waits_for(job, [failed, worker("gpu:1", "testing")]) is None


def test_a_pool_takes_what_the_gpus_that_work_are_enough_for() -> None:
    job = make_job(resources={"gpus": 3})
    pool = [worker(f"gpu:{n}", pool="gpu:0-3", queues=queue_names(f"gpu:{n}", pool=4)) for n in range(3)]
    failed = worker("gpu:3", "device_failed", pool="gpu:0-3", queues=queue_names("gpu:3", pool=4))
    assert what_it_waits_for(job, [*pool, failed]) is None
    assert what_it_waits_for(make_job(resources={"gpus": 4}), [*pool, failed]) == (
        "No host has 4 GPUs that work. host:gpu:3: A test of the device gpu:3 failed."
    )
    assert what_it_waits_for(make_job(resources={"gpus": 8}), pool) == (
        "No worker has exactly 8 GPUs: the workers here have 4 GPUs of one host."
    )


@pytest.mark.parametrize(
    ("resources", "needed"),
    [
        ({"gpus": 4, "hosts": 2}, "exactly 2 GPUs on each of exactly 2 hosts"),
        ({"gpus": 3, "hosts": 3}, "exactly 1 GPU on each of exactly 3 hosts"),
        ({"accelerator": "cpu", "hosts": 2}, "a CPU on each of exactly 2 hosts"),
    ],
)
def test_a_job_for_several_hosts_says_that_no_worker_has_as_many(
    resources: dict[str, object], needed: str
) -> None:
    told = what_it_waits_for(make_job(resources=resources), [worker("gpu:0,1"), worker("gpu:0,1", hosts=4)])
    assert told == f"No worker has {needed}: the workers here have gpu:0,1, gpu:0,1 on each of 4 hosts."


def test_a_worker_that_waits_for_its_hosts_is_named() -> None:
    job, missing = make_job(resources={"gpus": 4, "hosts": 2}), "1 of 2 hosts are here; missing: rank 1."
    incomplete = worker("gpu:0,1", "incomplete", hosts=2, problem=missing)
    assert what_it_waits_for(job, [incomplete]) == f"Each suitable worker waits: host:gpu:0,1: {missing}"
    assert what_it_waits_for(job, [incomplete, worker("gpu:2,3", hosts=2)]) is None


@pytest.mark.parametrize(
    ("asked", "has", "sentence"),
    [
        ({"physics": "warp"}, [()], "the engine warp (uv sync --inexact --extra warp)"),
        ({"physics": "warp"}, [(), ("warp",)], None),
        ({"physics": "warp"}, [(), None], None),  # A worker of an older version may have it.
        ({"physics": "compiled"}, [("warp",)], "the engine compiled (uv sync --inexact --extra compiled)"),
        ({"physics": "compiled"}, [(), ("llvmlite",)], None),
        ({"physics": "native"}, [()], None),
        ({}, [()], None),
        ({"environment": "rodent"}, [()], "the environment rodent (uv sync --inexact --extra dm-control)"),
        (
            {"environment": "playground/CheetahRun", "physics": "warp"},
            [(), ("warp",)],  # The one that lacks less is the one to mend.
            "the environment playground/CheetahRun (uv sync --inexact --extra playground)",
        ),
    ],
)
def test_a_job_says_which_package_no_worker_has(
    asked: dict[str, Any], has: list[tuple[str, ...] | None], sentence: str | None
) -> None:
    told = what_it_waits_for(make_job(**asked), [worker("cpu", packages=packages) for packages in has])
    if sentence is None:
        assert told is None
    else:
        assert told == (f"No suitable worker can run {sentence}: install it there, or choose another.")


def test_an_environment_may_need_a_package_that_no_extra_installs(monkeypatch: pytest.MonkeyPatch) -> None:
    ant = replace(
        catalog.ENVIRONMENTS["ant"], package="json"
    )  # One that is installed, in place of a new one.
    monkeypatch.setitem(catalog.ENVIRONMENTS, "ant", ant)
    told = what_it_waits_for(make_job(environment="ant"), [worker("cpu", packages=())])
    assert told is not None
    assert "the environment ant (the Python package json): install it there" in told
    assert "json" in packages_here()


@pytest.mark.parametrize("engine", ["warp", "compiled"])
def test_a_job_that_began_on_an_engine_with_a_package_needs_it_again(engine: str) -> None:
    without, job = worker("cpu", packages=()), make_job()
    file = Artifact(name="c", role="checkpoint", media_type="", size=1, sha256="", key="k", step=1)
    running = job.claimed("w", NOON).running(device="cpu", engine=engine).with_artifacts((file,))
    waiting = running.requeued(Reason.WORKER_DRAINED, "", NOON)
    assert what_it_waits_for(job, [without]) is None
    assert f"the engine {engine}" in str(what_it_waits_for(waiting, [without]))


_RODENT_ON_WARP = {"environment": "rodent", "physics": "warp"}


@pytest.mark.parametrize(
    ("asked", "has", "others", "named"),
    [
        ({}, (), [("cpu", "ready", ("warp",))], None),
        ({"physics": "warp"}, (), [("cpu", "ready", ("warp",))], "the engine warp"),
        ({"physics": "warp"}, ("warp",), [("cpu", "ready", ("warp",))], None),
        ({"physics": "compiled"}, ("warp",), [("cpu", "ready", ("llvmlite",))], "the engine compiled"),
        ({"physics": "warp"}, (), [], None),
        ({"physics": "warp"}, (), [("cpu", "ready", ())], None),
        ({"physics": "warp"}, (), [("cpu", "ready", None)], None),  # It may have it, or not.
        ({"physics": "warp"}, (), [("cpu", "device_failed", ("warp",))], None),
        ({"physics": "warp"}, (), [("gpu:0,1", "ready", ("warp",))], None),  # It serves other queues.
        (_RODENT_ON_WARP, (), [("cpu", "ready", ("warp",)), ("gpu:0", "ready", ("dm_control",))], None),
        (_RODENT_ON_WARP, ("warp",), [("gpu:0", "ready", ("dm_control", "warp"))], "the environment rodent"),
    ],
)
def test_a_job_is_left_to_another_worker_that_has_all_it_needs(
    asked: dict[str, Any],
    has: tuple[str, ...],
    others: list[tuple[str, WorkerState, tuple[str, ...] | None]],
    named: str | None,
) -> None:
    here = [worker(device, state, packages=packages) for device, state, packages in others]
    told = why_left_to_others(make_job(**asked), has, [worker("cpu", packages=has), *here])
    if named is None:
        assert told is None
    else:
        assert told is not None
        assert told.startswith(f"This worker cannot run {named} (uv sync --inexact --extra ")
        assert told.endswith(f"; {here[-1].name} can.")


def test_a_job_that_somebody_has_claimed_is_left_to_nobody() -> None:
    claimed = make_job(physics="warp").claimed("w", NOON)
    assert why_left_to_others(claimed, (), [worker("cpu", packages=("warp",))]) is None


_LARGE = {"num_envs": 1024, "batch_size": 1024, "num_minibatches": 1024, "unroll_length": 100}


@pytest.mark.parametrize(
    ("workers", "sentence"),
    [
        ([("cpu", 16)], None),
        ([("cpu", 8), ("cpu", None)], None),
        ([("cpu", 8), ("gpu:0", 80)], None),
        ([("cpu", 8), ("gpu:0", 15)], "the largest GPU of a worker has 15 GiB: lower batch_size"),
    ],
)
def test_a_job_says_that_no_worker_has_the_memory(
    workers: list[tuple[str, int | None]], sentence: str | None
) -> None:
    here = [worker(device, memory_bytes=gib and gib * 2**30) for device, gib in workers]
    told = what_it_waits_for(make_job(algorithm=_LARGE), here)
    assert told is None if sentence is None else sentence in str(told)
    if sentence:  # A large worker without what the job needs else is none.
        able = worker("gpu:0", packages=(), memory_bytes=80 * 2**30)
        other = worker("cpu", packages=("warp",), memory_bytes=2**30)
        told = what_it_waits_for(make_job(algorithm=_LARGE, physics="warp"), [able, other])
        assert "the largest CPU of a worker has 1 GiB" in str(told)


def test_a_job_that_today_would_be_refused_is_left_to_its_attempt() -> None:
    job = make_job(environment={"id": "no_such_body"}, algorithm=_LARGE)
    assert what_it_waits_for(job, [worker("cpu", packages=(), memory_bytes=1)]) is None


def test_a_job_that_has_begun_waits_for_nobody() -> None:
    assert what_it_waits_for(make_job().claimed("w", NOON), []) is None
