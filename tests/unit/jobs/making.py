"""Jobs for tests."""

from datetime import UTC, datetime, timedelta
from typing import Any

from core.jobs.job import Job, new_job_id
from core.jobs.spec import JOB_SPEC

NOON = datetime(2026, 1, 1, 12, tzinfo=UTC)


def make_job(*, minutes: float = 0, **fields: Any) -> Job:
    """A queued job of `minutes` after noon; by default an ant's training with the defaults."""
    when = NOON + timedelta(minutes=minutes)
    spec = JOB_SPEC.validate_python({"kind": "train", "environment": "ant", **fields})
    return Job(id=new_job_id(when), spec=spec, created_at=when)
