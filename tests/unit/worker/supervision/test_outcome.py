"""What an attempt's end means: the last word goes first, then what was asked, then how the process ended."""

from signal import SIGABRT, SIGBUS, SIGILL, SIGSEGV

import pytest

from core.jobs.status import JobStatus
from core.reasons import Reason
from worker.protocol import Failed, Finished
from worker.stopping import DRAIN_SIGNAL, Stop
from worker.supervision.outcome import judge

DIVERGED = Failed(reason=Reason.DIVERGED, message="The reward became non-finite.")
BAD_CARD = Failed(reason=Reason.DEVICE_FAILED, message="The device gpu:0 reported an error.")
TOO_LARGE = Failed(reason=Reason.OUT_OF_MEMORY, message="The memory of gpu:0 ran out.")
NO_MEMORY = Failed(reason=Reason.OUT_OF_HOST_MEMORY, message="The worker's memory ran out.")
DRAINED = Failed(reason=Reason.WORKER_DRAINED, message="The worker was shut down before it had started.")
FULL = Failed(reason=Reason.STORAGE_UNAVAILABLE, message="The disk of the worker is full.")


@pytest.mark.parametrize(
    ("last_word", "exit_status", "stop", "status", "reason"),
    [
        (Finished(), 0, None, JobStatus.SUCCEEDED, Reason.COMPLETED),
        # It came to its end before the word to stop reached it.
        (Finished(), 0, Stop.CANCEL, JobStatus.SUCCEEDED, Reason.COMPLETED),
        (Finished(stopped=True), 0, Stop.CANCEL, JobStatus.CANCELLED, Reason.USER_CANCELLED),
        (Finished(stopped=True), 0, Stop.TIMEOUT, JobStatus.FAILED, Reason.TIMEOUT),
        (Finished(stopped=True), 0, Stop.DRAIN, None, Reason.WORKER_DRAINED),
        (DIVERGED, 1, None, JobStatus.FAILED, Reason.DIVERGED),
        (DIVERGED, 1, Stop.DRAIN, JobStatus.FAILED, Reason.DIVERGED),
        (None, -9, Stop.CANCEL, JobStatus.CANCELLED, Reason.USER_CANCELLED),
        (None, -9, Stop.DRAIN, None, Reason.WORKER_DRAINED),
        (None, -DRAIN_SIGNAL, Stop.DRAIN, None, Reason.WORKER_DRAINED),
        (FULL, 1, None, None, Reason.STORAGE_UNAVAILABLE),
        (FULL, 1, Stop.CANCEL, None, Reason.STORAGE_UNAVAILABLE),
        # Another attempt would have its time anew.
        (FULL, 1, Stop.TIMEOUT, JobStatus.FAILED, Reason.STORAGE_UNAVAILABLE),
        (None, -9, None, None, Reason.TRAINING_KILLED),
        *((None, -number, None, None, Reason.NATIVE_CRASH) for number in (SIGSEGV, SIGBUS, SIGILL, SIGABRT)),
        (BAD_CARD, 1, None, None, Reason.DEVICE_FAILED),
        (DRAINED, 1, None, None, Reason.WORKER_DRAINED),
        # What the device lacks once, it lacks every time.
        (TOO_LARGE, 1, None, JobStatus.FAILED, Reason.OUT_OF_MEMORY),
        (NO_MEMORY, 1, None, None, Reason.OUT_OF_HOST_MEMORY),
        (None, 3, None, JobStatus.FAILED, Reason.TRAINING_CRASHED),
    ],
)
def test_every_end_has_its_outcome(
    last_word: Failed | Finished | None,
    exit_status: int,
    stop: Stop | None,
    status: JobStatus | None,
    reason: Reason,
) -> None:
    outcome = judge(last_word, exit_status, stop, timeout_s=60)
    assert (outcome.status, outcome.reason) == (status, reason)
    assert outcome.message.endswith((".", "why."))


def test_a_kill_by_the_kernel_for_memory_is_told_from_one_by_somebody() -> None:
    killed = judge(None, -9, None, timeout_s=60)
    assert (killed.reason, "SIGKILL" in killed.message) == (Reason.TRAINING_KILLED, True)
    starved = judge(None, -9, None, timeout_s=60, memory_ran_out=True)
    assert (starved.status, starved.reason) == (None, Reason.OUT_OF_HOST_MEMORY)
    assert "Lower num_envs" in starved.message


def test_a_crash_beside_a_kill_for_memory_stays_a_crash() -> None:
    assert judge(None, -11, None, timeout_s=60, memory_ran_out=True).reason == Reason.NATIVE_CRASH


def test_who_had_nothing_new_to_keep_is_not_said_to_be_killed() -> None:
    assert "killed" in judge(None, -9, Stop.DRAIN, timeout_s=60).message
    assert "killed" not in judge(None, -DRAIN_SIGNAL, Stop.DRAIN, timeout_s=60).message


def test_an_attempt_that_made_room_says_for_which_job() -> None:
    outcome = judge(Finished(stopped=True), 0, Stop.DRAIN, timeout_s=60, room_for="job a")
    message = "It made room for job a. The work up to then is kept."
    assert (outcome.status, outcome.reason, outcome.message) == (None, Reason.PREEMPTED, message)
