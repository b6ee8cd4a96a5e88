"""The part of a cluster that this worker was given: its names, and the time that is left of it."""

import time
from collections.abc import Callable, Mapping
from datetime import datetime, timedelta

# By name in the record: the variables that Slurm sets for a job.
_SLURM = {
    "id": "SLURM_JOB_ID",
    "node": "SLURMD_NODENAME",
    "account": "SLURM_JOB_ACCOUNT",
    "partition": "SLURM_JOB_PARTITION",
    "qos": "SLURM_JOB_QOS",
}
# A busy worker looks every ten seconds whether its time is over.
_SLACK_S = 15.0


def allocation(environ: Mapping[str, str]) -> dict[str, str]:
    """What the cluster calls the allocation that this process runs in, for the record; empty outside of one.

    `scheduler` is `slurm`; then `id`, `node`, `account`, `partition` and `qos`, as far as it names them.
    """
    if not environ.get("SLURM_JOB_ID"):
        return {}
    names = {name: environ.get(variable, "") for name, variable in _SLURM.items()}
    return {"scheduler": "slurm", **{name: value for name, value in names.items() if value}}


class TimeLeft:
    """When a worker must begin to drain, and until when it may take a job.

    ends_at: when its machine is taken away; None: never. grace: the time that a drain takes at most.
    start_margin: the time from taking a job to its first checkpoint. clock: seconds since 1970.
    """

    def __init__(
        self,
        ends_at: datetime | None,
        grace: timedelta,
        start_margin: timedelta,
        clock: Callable[[], float] = time.time,
    ) -> None:
        self._clock = clock
        self._drain_at = None
        if ends_at is not None:
            self._drain_at = ends_at.timestamp() - grace.total_seconds() - _SLACK_S
        self._start_margin_s = start_margin.total_seconds()
        self._began_at = clock()

    def is_over(self) -> bool:
        """Whether a running job must drain now."""
        return self._drain_at is not None and self._clock() >= self._drain_at

    def is_too_short(self) -> bool:
        """Whether a job that is taken now would not come to a checkpoint.

        False for a worker that has just started: no other one would have more time.
        """
        if self._drain_at is None:
            return False
        now = self._clock()
        if now >= self._drain_at:
            return True
        return now + self._start_margin_s > self._drain_at and now - self._began_at > self._start_margin_s
