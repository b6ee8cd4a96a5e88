"""When a drain ends the training process by itself, and when it only leaves word."""

import os
import signal
from collections.abc import Iterator
from contextlib import suppress

import pytest

from worker.stopping import DRAIN_SIGNAL, STOP_SIGNAL, StopRequest


@pytest.fixture
def stopping() -> Iterator[StopRequest]:
    before = {number: signal.getsignal(number) for number in (DRAIN_SIGNAL, STOP_SIGNAL)}
    yield StopRequest()
    for number, handler in before.items():
        signal.signal(number, handler)


def test_there_is_something_to_keep_again_also_after_a_failure_to_show_it(stopping: StopRequest) -> None:
    stopping.keep_before_leaving()
    with suppress(RuntimeError), stopping.nothing_to_keep():
        assert signal.getsignal(DRAIN_SIGNAL) == signal.SIG_DFL
        raise RuntimeError("no film")
    os.kill(os.getpid(), DRAIN_SIGNAL)  # By default it would end this process.
    assert (stopping.asked, stopping.leaving) == (True, True)


def test_word_may_be_left_twice(stopping: StopRequest) -> None:
    stopping.keep_before_leaving()
    for _ in range(2):
        os.kill(os.getpid(), DRAIN_SIGNAL)
    assert stopping.leaving


def test_a_part_of_a_shared_job_leaves_signals_to_the_leader(stopping: StopRequest) -> None:
    stopping.is_the_leaders()
    os.kill(os.getpid(), DRAIN_SIGNAL)  # By default it would end this process.
    os.kill(os.getpid(), STOP_SIGNAL)
    assert not stopping.asked
