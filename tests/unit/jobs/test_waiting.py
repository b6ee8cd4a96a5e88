"""A job that no worker could take says so."""

import pytest

from core.jobs.queue import queue_names
from core.jobs.store import WorkerInfo, WorkerState
from core.jobs.waiting import what_it_waits_for
from tests.unit.jobs.making import NOON, make_job


def worker(device: str, state: WorkerState = "ready") -> WorkerInfo:
    return WorkerInfo(
        name=f"host:{device}",
        host="host",
        pid=1,
        device=device,
        queues=queue_names(device),
        state=state,
        problem="A test of the device gpu:0 failed." if state == "device_failed" else None,
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
        (
            {"gpus": 4},
            ["gpu:0", "cpu", "cpu", "gpu:0,1"],
            "No worker with exactly 4 GPUs is there: the workers here have cpu, gpu:0, gpu:0,1.",
        ),
        (
            {"accelerator": "gpu"},
            ["cpu", "gpu:0,1"],
            "No worker with a GPU to itself is there: the workers here have cpu, gpu:0,1.",
        ),
        ({"accelerator": "cpu"}, ["gpu:0"], "No worker with a CPU is there: the workers here have gpu:0."),
        ({}, [], "No worker with one GPU or a CPU is there: no worker is there at all."),
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
        "The device of each worker that fits was set aside: host:gpu:0: A test of the device gpu:0 failed."
    )
    assert what_it_waits_for(job, [failed, worker("gpu:1", "testing")]) is None


def test_a_job_that_has_begun_waits_for_nobody() -> None:
    assert what_it_waits_for(make_job().claimed("w", NOON), []) is None
