"""What an attempt's end means: the last word goes first, then what was asked, then how the process ended."""

import pytest

from core.jobs.status import JobStatus, Reason
from worker.messages import Failed, Finished
from worker.outcome import Stop, judge

DIVERGED = Failed(reason=Reason.DIVERGED, message="The reward became non-finite.")


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
