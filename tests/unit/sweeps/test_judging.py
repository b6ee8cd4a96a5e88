"""The GPU hours that a trial has used."""

from datetime import timedelta

import pytest

from core.jobs.job import Job
from core.jobs.spec import JOB_SPEC
from core.reasons import Reason
from core.sweeps.judging import judged
from tests.unit.sweeps.making import JOB, NOON, sweep_of, trial_of

HOUR = timedelta(hours=1)


@pytest.mark.parametrize(
    ("device", "gpus", "hours"),
    [("gpu: H100", 1, 1.0), ("gpu: H100", 2, 2.0), ("cpu", 1, 0.0), (None, 1, 0.0)],
    ids=["one gpu", "two gpus", "cpu", "nothing said"],
)
def test_gpu_hours_are_those_of_the_gpus_that_it_held(device: str | None, gpus: int, hours: float) -> None:
    spec = JOB_SPEC.validate_python({**JOB, "resources": {"gpus": gpus}})
    job = Job(id="019aa3c2f0b1-5be0c1d2e3", spec=spec, created_at=NOON).claimed("w", NOON)
    job = job.running(device=device).requeued(Reason.WORKER_LOST, "", NOON + HOUR)
    trial = judged(trial_of(0), job, sweep_of().spec.objectives, NOON + 2 * HOUR)
    assert trial.gpu_hours == pytest.approx(hours)
