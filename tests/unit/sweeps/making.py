"""Sweeps and trials for tests."""

from datetime import UTC, datetime
from typing import Any

from core.jobs.job import new_job_id
from core.sweeps.spec import SWEEP_SPEC, SweepSpec
from core.sweeps.sweep import Sweep, Trial

NOON = datetime(2026, 11, 25, 12, tzinfo=UTC)
JOB = {"kind": "train", "environment": "ant", "algorithm": {"kind": "ppo", "num_timesteps": 1000}}


def spec_of(**said: Any) -> SweepSpec:
    """A grid over two seeds, or what is said."""
    return SWEEP_SPEC.validate_python({"job": JOB, "method": "grid", "parameters": {"seed": [1, 2]}, **said})


def sweep_of(**said: Any) -> Sweep:
    return Sweep(id=new_job_id(NOON), spec=spec_of(**said), created_at=NOON)


def trial_of(number: int, **said: Any) -> Trial:
    """A trial that runs, or what is said."""
    facts = {"job": f"job {number}", "parameters": {"seed": 1}, "planned_steps": 1000, "created_at": NOON}
    return Trial.model_validate({"number": number, **facts, **said})
