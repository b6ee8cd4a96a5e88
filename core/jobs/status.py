"""A job's lifecycle as a table."""

from enum import StrEnum

from core.reasons import Reason


class JobStatus(StrEnum):
    """queued → starting → running → succeeded or failed; cancelling → cancelled.

    A lost or drained attempt returns the job to queued, if it may have another. A queued job is cancelled at
    once; one that is cancelling may have succeeded or failed before.
    """

    QUEUED = "queued"
    STARTING = "starting"
    RUNNING = "running"
    CANCELLING = "cancelling"
    SUCCEEDED = "succeeded"
    FAILED = "failed"
    CANCELLED = "cancelled"

    @property
    def is_final(self) -> bool:
        return not NEXT[self]

    @property
    def is_held(self) -> bool:
        """Whether an attempt holds the job now."""
        return self in (JobStatus.STARTING, JobStatus.RUNNING, JobStatus.CANCELLING)


NEXT: dict[JobStatus, frozenset[JobStatus]] = {
    JobStatus.QUEUED: frozenset({JobStatus.STARTING, JobStatus.CANCELLED, JobStatus.FAILED}),
    # Back to queued: the attempt was lost or drained, and another one is allowed.
    JobStatus.STARTING: frozenset(
        {JobStatus.RUNNING, JobStatus.CANCELLING, JobStatus.SUCCEEDED, JobStatus.FAILED, JobStatus.QUEUED}
    ),
    JobStatus.RUNNING: frozenset(
        {JobStatus.CANCELLING, JobStatus.SUCCEEDED, JobStatus.FAILED, JobStatus.QUEUED}
    ),
    # A job may have succeeded or failed before the cancel reached it.
    JobStatus.CANCELLING: frozenset({JobStatus.CANCELLED, JobStatus.SUCCEEDED, JobStatus.FAILED}),
    JobStatus.SUCCEEDED: frozenset(),
    JobStatus.FAILED: frozenset(),
    JobStatus.CANCELLED: frozenset(),
}


# Reasons after which another attempt may follow, and which count against a job's `max_attempts`. A drained
# worker or a bad or held card does not count, because it is not the job's fault. A full disk, or a store that
# stays unavailable, may be a problem of this machine only.
LOSSES = frozenset(
    {
        Reason.WORKER_LOST,
        Reason.TRAINING_KILLED,
        Reason.TRAINING_STALLED,
        Reason.NATIVE_CRASH,
        Reason.OUT_OF_HOST_MEMORY,
        Reason.STORAGE_UNAVAILABLE,
    }
)
# Reasons that may be the fault of a machine or a card, but count as the job's own after this many attempts.
MAX_ATTEMPTS: dict[Reason, int] = {Reason.OUT_OF_HOST_MEMORY: 2, Reason.DEVICE_FAILED: 3}
# A training that reports one of these may succeed elsewhere.
RETRIED = LOSSES | MAX_ATTEMPTS.keys() | {Reason.DEVICE_HELD}
