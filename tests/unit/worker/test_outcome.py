"""What an attempt's end means: the last word goes first, then what was asked, then how the process ended."""

import pytest

from core.jobs.status import JobStatus, Reason
from worker.messages import KEEP_AND_GO, Failed, Finished
from worker.outcome import Stop, judge

DIVERGED = Failed(reason=Reason.DIVERGED, message="The reward became non-finite.")
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
        (None, -KEEP_AND_GO, Stop.DRAIN, None, Reason.WORKER_DRAINED),
        (FULL, 1, None, None, Reason.STORAGE_UNAVAILABLE),
        (FULL, 1, Stop.CANCEL, None, Reason.STORAGE_UNAVAILABLE),
        # Another attempt would have its time anew.
        (FULL, 1, Stop.TIMEOUT, JobStatus.FAILED, Reason.STORAGE_UNAVAILABLE),
        (None, -9, None, None, Reason.TRAINING_KILLED),
        (None, -11, None, None, Reason.TRAINING_KILLED),
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


def test_a_killed_process_names_the_signal_and_what_may_be_behind_it() -> None:
    message = judge(None, -9, None, timeout_s=60).message
    assert "SIGKILL" in message
    assert "memory" in message


def test_who_had_nothing_new_to_keep_is_not_said_to_be_killed() -> None:
    assert "killed" in judge(None, -9, Stop.DRAIN, timeout_s=60).message
    assert "killed" not in judge(None, -KEEP_AND_GO, Stop.DRAIN, timeout_s=60).message
