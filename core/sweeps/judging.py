"""Reads the outcome of a trial from its job."""

from collections.abc import Sequence
from datetime import datetime

from core.jobs.job import Attempt, Job, UnreadableJob
from core.jobs.status import JobStatus
from core.sweeps.spec import Objective
from core.sweeps.sweep import Outcome, Trial

_OUTCOMES: dict[JobStatus, Outcome] = {
    JobStatus.SUCCEEDED: "succeeded",
    JobStatus.FAILED: "failed",
    JobStatus.CANCELLED: "cancelled",
}


def judged(
    trial: Trial, job: Job | UnreadableJob | None, objectives: Sequence[Objective], now: datetime
) -> Trial:
    """The trial as its job is now; with an outcome once that has ended. job: None if it was deleted."""
    if trial.outcome is not None:
        return trial
    if job is None:
        return trial.model_copy(update={"outcome": "deleted", "job": None, "finished_at": now})
    outcome = _OUTCOMES.get(job.status)
    if isinstance(job, UnreadableJob):
        message = f"This version cannot read its record ({job.problem})."
        return trial.model_copy(
            update={"outcome": outcome, "message": message, "finished_at": job.finished_at}
        )
    # One that succeeded before the cancel reached it has its last value.
    if trial.is_pruned and outcome == "cancelled":
        outcome = "pruned"
    metrics = job.progress.metrics
    return trial.model_copy(
        update={
            "outcome": outcome,
            "message": job.message,
            "values": tuple(metrics.get(objective.metric) for objective in objectives),
            # A run that resumes counts from the beginning of its lineage, and each of several seeds its own.
            "steps": max(0, job.progress.step - trial.inherited_steps) * max(1, len(job.seeds)),
            "gpu_hours": sum(_gpu_hours(one, job.spec.resources.gpus, now) for one in job.attempts),
            "finished_at": job.finished_at,
        }
    )


def _gpu_hours(attempt: Attempt, gpus: int, now: datetime) -> float:
    """Hours of the GPUs that the attempt held; 0 on a CPU, or before it has reported its device."""
    if attempt.device is None or attempt.device.startswith("cpu"):
        return 0.0
    return gpus * ((attempt.ended_at or now) - attempt.started_at).total_seconds() / 3600
