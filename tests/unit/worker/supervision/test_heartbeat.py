"""A heart that beats on, whatever the record answers; only a lost lease stops it."""

from collections.abc import Callable
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest

from core.errors import LeaseLost, RecordsUnavailable
from core.jobs.attempts import Claim
from core.jobs.status import JobStatus
from core.jobs.store import Renewal
from tests.faults.bench import unused_servers, wait_until
from tests.in_memory import MemoryObjectStore
from worker.stopping import Draining
from worker.supervision.watching import Heartbeat


class Answers:
    """A record that answers each renewal with the next of these, and then with the last one."""

    def __init__(self, *answers: JobStatus | Renewal | Exception) -> None:
        self.num_beats = 0
        self._answers = answers

    def renew(self, job_id: str, token: str, lease: timedelta) -> Renewal:
        answer = self._answers[min(self.num_beats, len(self._answers) - 1)]
        self.num_beats += 1
        if isinstance(answer, Exception):
            raise answer
        return answer if isinstance(answer, Renewal) else Renewal(answer)


@pytest.fixture
def beating(tmp_path: Path) -> Callable[[Answers], Heartbeat]:
    def beat(answers: Answers) -> Heartbeat:
        store: Any = answers
        claim = Claim("job", 1, "1-x", store, MemoryObjectStore())
        return Heartbeat(claim, unused_servers(tmp_path), Draining())

    return beat


def test_outages_and_mistakes_of_ours_cost_no_lease(beating: Callable[[Answers], Heartbeat]) -> None:
    answers = Answers(RecordsUnavailable("away"), ValueError("a mistake"), KeyError(), JobStatus.RUNNING)
    with beating(answers) as heart:
        wait_until(lambda: answers.num_beats >= 6)
        assert not heart.lost.is_set()
        assert not heart.cancelled.is_set()


def test_a_cancel_is_heard_and_the_lease_is_renewed_all_the_same(
    beating: Callable[[Answers], Heartbeat],
) -> None:
    answers = Answers(JobStatus.RUNNING, JobStatus.CANCELLING)
    with beating(answers) as heart:
        assert heart.cancelled.wait(10)
        wait_until(lambda: answers.num_beats >= 4)
        assert not heart.lost.is_set()


def test_a_lost_lease_stops_it(beating: Callable[[Answers], Heartbeat]) -> None:
    answers = Answers(JobStatus.RUNNING, LeaseLost("job"))
    with beating(answers) as heart:
        assert heart.lost.wait(10)
    assert answers.num_beats == 2


def test_an_attempt_makes_room_unless_it_is_cancelled_or_its_worker_shuts_down(tmp_path: Path) -> None:
    store: Any = Answers(Renewal(JobStatus.RUNNING, "job a"))
    claim, told, leaving = Claim("job", 1, "1-x", store, MemoryObjectStore()), Draining(), Draining()
    leaving.set()
    for draining in (told, leaving):
        store.num_beats = 0
        with Heartbeat(claim, unused_servers(tmp_path), draining) as heart:
            wait_until(lambda: store.num_beats >= 2)
            assert not heart.lost.is_set()
    assert (told.is_set(), told.room_for) == (True, "job a")
    assert (leaving.is_set(), leaving.room_for) == (True, None)
    store, cancelled = Answers(Renewal(JobStatus.CANCELLING, "job a")), Draining()
    with Heartbeat(Claim("job", 1, "1-x", store, MemoryObjectStore()), unused_servers(tmp_path), cancelled):
        wait_until(lambda: store.num_beats >= 2)
    assert not cancelled.is_set()
