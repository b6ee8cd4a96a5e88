"""The database's clock is asked once a second, and counted on from."""

from datetime import UTC, datetime, timedelta

import pytest

from core.adapters.postgres import engine
from core.adapters.postgres.engine import Clock

NOON = datetime(2026, 1, 1, 12, tzinfo=UTC)
SECOND = timedelta(seconds=1)


class Time:
    """A monotonic clock that a test winds, and a database whose clock goes with it."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.passed_s = 100.0
        self.trip_s = 0.001
        self.asked = 0
        self.step = timedelta(0)
        monkeypatch.setattr(engine.time, "monotonic", lambda: self.passed_s)

    def ask(self) -> datetime:
        self.asked += 1
        self.passed_s += self.trip_s
        return self.now()

    def now(self) -> datetime:
        return NOON + timedelta(seconds=self.passed_s) + self.step


@pytest.fixture
def time(monkeypatch: pytest.MonkeyPatch) -> Time:
    return Time(monkeypatch)


def test_between_two_answers_it_counts_on(time: Time) -> None:
    said = Clock(time.ask, SECOND)
    assert said.now() == time.now()
    time.passed_s += 0.7
    assert said.now() == time.now()
    assert time.asked == 1


def test_a_step_of_the_databases_clock_is_seen_after_a_second(time: Time) -> None:
    said = Clock(time.ask, SECOND)
    said.now()
    time.step = timedelta(hours=1)
    time.passed_s += 1
    assert said.now() == time.now()


def test_a_slow_answer_is_not_counted_on_from(time: Time) -> None:
    said = Clock(time.ask, SECOND)
    time.trip_s = 0.5
    said.now()
    said.now()
    assert time.asked == 2
