"""The outcome of an attempt for its job."""

import signal
from dataclasses import dataclass

from core.jobs.status import RETRIED, JobStatus
from core.reasons import Reason
from worker.host.memory import LESS_MEMORY
from worker.protocol import Failed, Finished
from worker.stopping import DRAIN_SIGNAL, Stop

# How a process ends whose native code crashed, or found an error of its own.
_CRASHES = frozenset(
    {
        signal.SIGSEGV,
        signal.SIGBUS,
        signal.SIGILL,
        signal.SIGFPE,
        signal.SIGABRT,
        signal.SIGTRAP,
        signal.SIGSYS,
    }
)


@dataclass(frozen=True)
class Outcome:
    """status None: the job goes back to the queue, if another attempt is allowed."""

    status: JobStatus | None
    reason: Reason
    message: str


def judge(
    last_word: Failed | Finished | None,
    exit_status: int,
    stop: Stop | None,
    timeout_s: float,
    *,
    memory_ran_out: bool = False,
    room_for: str | None = None,
) -> Outcome:
    """The outcome, from the process's last message, its exit status and the stop that it was asked for.

    exit_status: negative: the signal that ended it. memory_ran_out: the kernel was killing for memory then.
    room_for: for which job it drained, as in `Draining`.
    """
    if isinstance(last_word, Failed):
        # Only a part on another host fails by a drain: it had not started yet.
        is_retried = last_word.reason in RETRIED | {Reason.WORKER_DRAINED}
        if is_retried and stop is not Stop.TIMEOUT:
            return Outcome(None, last_word.reason, last_word.message)
        return Outcome(JobStatus.FAILED, last_word.reason, last_word.message)
    if isinstance(last_word, Finished) and not last_word.stopped:
        return Outcome(JobStatus.SUCCEEDED, Reason.COMPLETED, "Everything asked for is done.")
    kept = (
        "The work up to then is kept."
        if last_word is not None or exit_status == -DRAIN_SIGNAL
        else "It did not stop within the grace time and was killed; its last checkpoint is kept."
    )
    match stop:
        case Stop.CANCEL:
            return Outcome(JobStatus.CANCELLED, Reason.USER_CANCELLED, f"Cancelled while it ran. {kept}")
        case Stop.TIMEOUT:
            return Outcome(
                JobStatus.FAILED,
                Reason.TIMEOUT,
                f"It took longer than timeout_s allows: {timeout_s:g} s. {kept}",
            )
        case Stop.DRAIN:
            return drained(room_for, f". {kept}")
        case None:
            return _crashed(exit_status, memory_ran_out=memory_ran_out)


def drained(room_for: str | None, rest: str) -> Outcome:
    """The outcome of an attempt that left its device. rest: of the sentence."""
    if room_for is None:
        return Outcome(None, Reason.WORKER_DRAINED, f"The worker was shut down{rest}")
    return Outcome(None, Reason.PREEMPTED, f"It made room for {room_for}{rest}")


def _crashed(exit_status: int, *, memory_ran_out: bool) -> Outcome:
    if exit_status >= 0:
        message = (
            f"The training process ended with status {exit_status} and gave no reason; its log may show why."
        )
        return Outcome(JobStatus.FAILED, Reason.TRAINING_CRASHED, message)
    name = signal.Signals(-exit_status).name
    again = "It resumes from its last checkpoint."
    if -exit_status == signal.SIGKILL and memory_ran_out:
        message = (
            "The machine's memory ran out, or the part that the training may use, and the kernel killed the "
            f"training process. {LESS_MEMORY} {again}"
        )
        return Outcome(None, Reason.OUT_OF_HOST_MEMORY, message)
    if -exit_status in _CRASHES:
        message = f"Native code of the training process crashed ({name}); its log may show where. {again}"
        return Outcome(None, Reason.NATIVE_CRASH, message)
    return Outcome(None, Reason.TRAINING_KILLED, f"The training process was ended by {name}. {again}")
