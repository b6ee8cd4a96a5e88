"""A job on two hosts, with the embedded service and a real worker for each host, here or under Slurm."""

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import psutil
import pytest

from gaitway.client import Client
from gaitway.schema import JobView
from gaitway.service.embedded.processes import free_ports
from gaitway.service.embedded.stack import STORES
from tests.compiling import compiling_quickly
from tests.e2e.conftest import serving
from tests.e2e.test_pipeline import UNFILMED, until_checkpoint
from tests.faults.bench import wait_until
from tests.slurm.local_slurm import LocalSlurm, missing

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]

# Three checkpoints.
ON_TWO = {
    **UNFILMED,
    "algorithm": {**UNFILMED["algorithm"], "num_timesteps": 153_600},
    "resources": {"accelerator": "cpu", "hosts": 2},
}
_WORKER = (sys.executable, "-m", "worker.main")


@pytest.fixture
def variables(tmp_path: Path) -> Mapping[str, str]:
    """Those of a worker of the service in this folder, but for its rank."""
    return {
        **os.environ,
        **json.loads((tmp_path / "stack" / STORES).read_text()),
        **compiling_quickly(),
        "GAITWAY_DEVICE": "cpu",
        "GAITWAY_HOSTS": "2",
        "GAITWAY_COORDINATOR": f"127.0.0.1:{free_ports(1)[0]}",
    }


@pytest.fixture
def service(tmp_path: Path, postgres_data: Path) -> Iterator[Client]:
    shutil.copytree(postgres_data, tmp_path / "stack" / "postgres" / "data")
    with serving(tmp_path / "stack", workers=0) as client:
        yield client


@pytest.fixture
def start(
    service: Client, variables: Mapping[str, str], tmp_path: Path
) -> Iterator[Callable[[int], "subprocess.Popen[bytes]"]]:
    """Starts the worker of a rank."""
    started: list[subprocess.Popen[bytes]] = []

    def begin(rank: int) -> "subprocess.Popen[bytes]":
        own = {"GAITWAY_HOST_RANK": str(rank), "GAITWAY_DATA_DIR": str(tmp_path / f"host{rank}")}
        (tmp_path / f"host{rank}").mkdir(exist_ok=True)
        started.append(subprocess.Popen(_WORKER, env={**variables, **own}))
        return started[-1]

    yield begin
    for worker in started:
        worker.terminate()
    assert [worker.wait(60) in (0, -signal.SIGKILL) for worker in started] == [True] * len(started)
    assert _trainings(tmp_path) == []


def test_a_job_waits_for_both_hosts_and_outlives_the_loss_of_one(
    service: Client, start: Callable[[int], "subprocess.Popen[bytes]"], tmp_path: Path
) -> None:
    undisturbed = service.submit(ON_TWO)
    waits = service.get(undisturbed.id).waiting_for
    assert waits == "No worker has a CPU on each of exactly 2 hosts: no worker is running."
    start(0)
    wait_until(lambda: [worker.state for worker in service.workers()] == ["incomplete"], 60)
    waits = service.get(undisturbed.id).waiting_for or ""
    assert waits.endswith("1 of 2 hosts are here; missing: rank 1.")
    second = start(1)
    undisturbed = service.wait(undisturbed.id, timeout=200)
    assert (undisturbed.status, undisturbed.message) == ("succeeded", "Everything asked for is done.")
    job = service.submit(ON_TWO)
    until_checkpoint(service, job)
    second.kill()
    wait_until(lambda: service.get(job.id).status == "queued", 30)
    attempt = service.get(job.id).attempts[0]
    assert (attempt.reason, "(rank 1) is lost" in (attempt.message or "")) == ("worker_lost", True)
    start(1)
    assert _end(service, job) == _end(service, undisturbed)
    endless = {**ON_TWO["algorithm"], "num_timesteps": 10**8}
    cancelled = service.submit({**ON_TWO, "algorithm": endless})
    until_checkpoint(service, cancelled)
    service.cancel(cancelled.id)
    assert service.wait(cancelled.id, timeout=100).status == "cancelled"
    wait_until(lambda: _trainings(tmp_path) == [])


@pytest.mark.skipif(missing() is not None, reason=missing() or "")
def test_srun_starts_both_hosts(service: Client, variables: Mapping[str, str], tmp_path: Path) -> None:
    """Their address is given: the nodes of this Slurm are names that nobody knows."""
    with LocalSlurm(tmp_path / "slurm"):
        words = ["srun", "--nodes=2", "--ntasks-per-node=1", "--wait=30"]
        folders = f'export GAITWAY_DATA_DIR={tmp_path}/host$SLURM_PROCID; mkdir -p "$GAITWAY_DATA_DIR"; exec '
        step = subprocess.Popen(
            [*words, "bash", "-c", folders + " ".join(_WORKER)], env={**os.environ, **variables}
        )
        job = service.submit(ON_TWO)
        assert service.wait(job.id, timeout=300).status == "succeeded"
        step.send_signal(signal.SIGUSR1)  # A drain, which srun passes on; SIGTERM it takes for itself.
        step.wait(60)
        wait_until(lambda: _trainings(tmp_path) == [])


def _end(client: Client, job: JobView) -> list[tuple[str, str]]:
    """What a finished job has learnt."""
    done = client.wait(job.id, timeout=200)
    assert done.status == "succeeded", done.message
    last = max(file.step or 0 for file in done.artifacts if file.role == "checkpoint")
    kept = ("checkpoint", "policy", "best_policy")
    return sorted((f.name, f.sha256) for f in done.artifacts if f.role in kept and f.step in (None, last))


def _trainings(folder: Path) -> list[int]:
    """Training processes that work in this folder."""
    lines = {found.pid: " ".join(found.info["cmdline"] or ()) for found in psutil.process_iter(["cmdline"])}
    return [pid for pid, line in lines.items() if "worker.training" in line and str(folder) in line]
