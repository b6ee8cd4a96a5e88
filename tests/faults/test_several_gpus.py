"""A job that several GPUs share, from its submission to its video; a CPU stands for the GPUs."""

import sys
from pathlib import Path
from typing import Any

import pytest

from core.adapters.postgres.store import PostgresJobStore
from core.jobs.attempts import claim_attempt, new_secret
from core.jobs.status import JobStatus
from core.reasons import Reason
from tests.compiling import compiling_quickly
from tests.faults.bench import SPEC, Bench
from worker.supervision.supervisor import Supervisor

pytestmark = pytest.mark.extra

_PRETENDED = (sys.executable, "-m", "tests.faults.pretended_gpus")
# 16 × 4 unrolls of 10 steps are 640 in an update: two updates.
_SMALL: dict[str, Any] = {
    **SPEC,
    "algorithm": {**SPEC["algorithm"], "num_timesteps": 1280},
    "physics": "native",
    "video": {"width": 64, "height": 48, "seconds": 0.2},
}


@pytest.fixture
def bench(tmp_path: Path, job_store: PostgresJobStore, monkeypatch: pytest.MonkeyPatch) -> Bench:
    for name, value in compiling_quickly("--xla_force_host_platform_device_count=2").items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("JAX_PLATFORMS", "cpu")
    return Bench(tmp_path, job_store)


@pytest.mark.timeout(300)
def test_two_gpus_share_a_job_that_asks_for_two(bench: Bench) -> None:
    job = bench.submit(**_SMALL, resources={"gpus": 2})
    assert bench.queue.take("cpu") is bench.queue.take("gpu:0") is None
    dispatch = bench.queue.take("gpu:0,1")
    assert dispatch is not None
    stores = {"store": bench.store, "objects": bench.objects}
    claim = claim_attempt(
        dispatch.job_id, dispatch.attempt, "w", **stores, lease=bench.settings.lease, secret=new_secret()
    )
    assert claim is not None
    Supervisor(claim, bench.settings, "gpu:0,1", ("nvidia0", "nvidia1"), _PRETENDED).run()
    done = bench.store.get(job.id)
    assert (done.status, done.reason) == (JobStatus.SUCCEEDED, Reason.COMPLETED), done.message
    assert (done.attempts[0].device, done.attempts[0].engine) == ("2 × Pretended", "native")
    said = [line for line in bench.printed(done) if not line.startswith('{"service": "training"')]
    assert said == ["laid out over 2"]
    checkpoint = done.newest("checkpoint")
    assert checkpoint is not None
    assert (checkpoint.step, done.progress.step) == (1280, 1280)
    assert done.newest("policy") is not None
    assert list((bench.settings.data_dir / "locks").iterdir()) == []
