"""What an attempt's end means for its job."""

import signal
from dataclasses import dataclass
from enum import StrEnum

from core.jobs.status import LOSSES, JobStatus, Reason
from worker.messages import KEEP_AND_GO, Failed, Finished


class Stop(StrEnum):
    """Why a training process was asked to stop."""

    CANCEL = "cancel"
    TIMEOUT = "timeout"
    DRAIN = "drain"


@dataclass(frozen=True)
class Outcome:
    """status None: the job goes back to the queue, if another attempt is allowed."""

    status: JobStatus | None
    reason: Reason
    message: str


def judge(
    last_word: Failed | Finished | None, exit_status: int, stop: Stop | None, timeout_s: float
) -> Outcome:
    """From the process' last word, how it ended, and what it had been asked.

    exit_status: negative is the signal that ended it.
    """
    if isinstance(last_word, Failed):
        if last_word.reason in LOSSES and stop is not Stop.TIMEOUT:
            return Outcome(None, last_word.reason, last_word.message)
        return Outcome(JobStatus.FAILED, last_word.reason, last_word.message)
    if isinstance(last_word, Finished) and not last_word.stopped:
        return Outcome(JobStatus.SUCCEEDED, Reason.COMPLETED, "Everything asked for is done.")
    kept = (
        "The work up to then is kept."
        if last_word is not None or exit_status == -KEEP_AND_GO
        else "It did not stop within the grace time and was killed; its last checkpoint is kept."
    )
    match stop:
        case Stop.CANCEL:
            return Outcome(JobStatus.CANCELLED, Reason.USER_CANCELLED, f"Cancelled while it ran. {kept}")
        case Stop.TIMEOUT:
            return Outcome(
                JobStatus.FAILED, Reason.TIMEOUT, f"It took longer than timeout_s = {timeout_s:g} s. {kept}"
            )
        case Stop.DRAIN:
            return Outcome(None, Reason.WORKER_DRAINED, f"The worker was shut down. {kept}")
        case None:
            return _crashed(exit_status)


def _crashed(exit_status: int) -> Outcome:
    if exit_status < 0:
        name = signal.Signals(-exit_status).name
        hint = " The kernel does that when memory runs out." if name == "SIGKILL" else ""
        message = f"The training process was ended by {name}.{hint} It goes on from its last checkpoint."
        return Outcome(None, Reason.TRAINING_KILLED, message)
    message = f"The training process ended with status {exit_status} and said nothing; its log may tell why."
    return Outcome(JobStatus.FAILED, Reason.TRAINING_CRASHED, message)
