"""Waiting for a store that is away: how long, until whose word, and what the log says meanwhile."""

import threading
import time

import pytest
from structlog.testing import capture_logs

from core import retry
from core.errors import RecordsUnavailable, StorageUnavailable, Unavailable
from core.retry import CalledOff, pause, retry_while_unavailable


class Store:
    """Away, with these words, as often as there are words; then it answers."""

    def __init__(self, *errors: Unavailable) -> None:
        self._errors = list(errors)

    def get(self) -> str:
        if self._errors:
            raise self._errors.pop(0)
        return "an answer"


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(retry, "_FIRST_PAUSE_S", 0.001)
    monkeypatch.setattr(retry, "_LONGEST_PAUSE_S", 0.001)


def test_an_outage_is_waited_out() -> None:
    assert retry_while_unavailable(Store(*[RecordsUnavailable("away")] * 3).get) == "an answer"


def test_patience_ends_with_what_the_store_said_last() -> None:
    with pytest.raises(RecordsUnavailable, match="away"):
        retry_while_unavailable(Store(*[RecordsUnavailable("away")] * 9999).get, 0.05)


def test_the_log_says_a_sentence_once_and_another_one_when_it_changes() -> None:
    away, full = RecordsUnavailable("away"), RecordsUnavailable("full")
    with capture_logs() as said:
        retry_while_unavailable(Store(away, away, away, full, full, away).get)
    assert [line["error"] for line in said] == ["away", "full", "away"]


def test_the_log_says_the_same_sentence_again_after_a_while(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(retry, "_LOG_AGAIN_AFTER_S", 0)
    with capture_logs() as said:
        retry_while_unavailable(Store(*[RecordsUnavailable("away")] * 3).get)
    assert [line["error"] for line in said] == ["away"] * 3


def test_what_gives_up_gives_up_at_once() -> None:
    with pytest.raises(StorageUnavailable):
        retry_while_unavailable(Store(StorageUnavailable("refused")).get, gives_up_on=(StorageUnavailable,))


def test_who_waits_hears_that_it_is_called_off(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(retry, "_FIRST_PAUSE_S", 1000)
    over = threading.Event()
    threading.Timer(0.05, over.set).start()
    with pytest.raises(CalledOff):
        retry_while_unavailable(Store(RecordsUnavailable("away")).get, called_off=over.is_set)


def test_what_answers_is_asked_even_where_nobody_would_wait() -> None:
    assert retry_while_unavailable(Store().get, called_off=lambda: True) == "an answer"


def test_a_pause_lasts_as_long_as_it_is_told() -> None:
    began = time.monotonic()
    pause(0.15)
    assert time.monotonic() - began >= 0.15
