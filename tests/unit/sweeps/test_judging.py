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
    ("device", "details", "gpus", "hours"),
    [
        ("gpu: H100", {}, 1, 1.0),
        ("gpu: H100", {}, 2, 2.0),
        ("gpu: H100", {"trained_together": 16}, 1, 1 / 16),
        ("cpu", {"trained_together": 4}, 1, 0.0),
        (None, {}, 1, 0.0),
    ],
    ids=["alone", "two gpus", "16 together", "cpu", "nothing said"],
)
def test_gpu_hours_are_those_of_the_share_that_it_had(
    device: str | None, details: dict[str, int], gpus: int, hours: float
) -> None:
    spec = JOB_SPEC.validate_python({**JOB, "resources": {"gpus": gpus}})
    job = Job(id="019aa3c2f0b1-5be0c1d2e3", spec=spec, created_at=NOON).claimed("w", NOON)
    job = job.running(device=device, details=details).requeued(Reason.WORKER_LOST, "", NOON + HOUR)
    trial = judged(trial_of(0), job, sweep_of().spec.objectives, NOON + 2 * HOUR)
    assert trial.gpu_hours == pytest.approx(hours)
