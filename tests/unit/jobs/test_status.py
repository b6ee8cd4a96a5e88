"""The status table, walked in every order that Hypothesis can think of."""

from datetime import timedelta

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from core.errors import IllegalTransition
from core.jobs.job import Job
from core.jobs.status import NEXT, JobStatus
from core.reasons import Reason
from tests.unit.jobs.making import NOON, make_job

FINAL = (JobStatus.SUCCEEDED, JobStatus.FAILED, JobStatus.CANCELLED)


@pytest.mark.parametrize("status", FINAL)
def test_a_final_status_leads_nowhere(status: JobStatus) -> None:
    assert status.is_final
    assert not NEXT[status]


def test_every_status_has_its_row_and_every_final_one_can_be_reached_from_the_queue() -> None:
    reached, frontier = {JobStatus.QUEUED}, {JobStatus.QUEUED}
    while frontier:
        frontier = {later for status in frontier for later in NEXT[status]} - reached
        reached |= frontier
    assert reached == set(JobStatus) == set(NEXT)


def test_only_an_attempt_that_holds_the_job_has_a_token() -> None:
    job = make_job()
    assert job.token == ""
    claimed = job.claimed("worker", NOON)
    assert claimed.token == claimed.attempts[0].token != ""
    assert claimed.requeued(Reason.WORKER_LOST, "lost", NOON).token == ""


class Life(RuleBasedStateMachine):
    """Any walk over `become`: versions rise by one, nothing leaves a final status."""

    def __init__(self) -> None:
        super().__init__()
        self.job: Job = make_job()
        self.steps = 1

    @rule(wanted=st.sampled_from(JobStatus))
    def become(self, wanted: JobStatus) -> None:
        before = self.job
        if wanted in NEXT[before.status]:
            self.job = before.become(wanted)
            self.steps += 1
        else:
            with pytest.raises(IllegalTransition):
                before.become(wanted)

    @precondition(lambda self: self.job.status == JobStatus.QUEUED)
    @rule(seconds=st.integers(0, 100))
    def claim(self, seconds: int) -> None:
        tokens = {attempt.token for attempt in self.job.attempts}
        self.job = self.job.claimed("worker", NOON + timedelta(seconds=seconds))
        self.steps += 1
        assert self.job.attempts[-1].token not in tokens

    @invariant()
    def the_version_counts_the_steps(self) -> None:
        assert self.job.version == self.steps

    @invariant()
    def attempts_are_numbered_from_one(self) -> None:
        assert [a.number for a in self.job.attempts] == list(range(1, len(self.job.attempts) + 1))


TestLife = Life.TestCase
