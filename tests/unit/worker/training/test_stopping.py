"""When a drain ends the training process by itself, and when it only leaves word."""

import os
import signal
from collections.abc import Iterator
from contextlib import suppress

import pytest

from worker.stop_signals import KEEP_AND_GO, SHOW_AND_GO
from worker.training.stopping import Stopping


@pytest.fixture
def stopping() -> Iterator[Stopping]:
    before = {number: signal.getsignal(number) for number in (KEEP_AND_GO, SHOW_AND_GO)}
    yield Stopping()
    for number, handler in before.items():
        signal.signal(number, handler)


def test_there_is_something_to_keep_again_also_after_a_failure_to_show_it(stopping: Stopping) -> None:
    stopping.keep_before_leaving()
    with suppress(RuntimeError), stopping.nothing_to_keep():
        assert signal.getsignal(KEEP_AND_GO) == signal.SIG_DFL
        raise RuntimeError("no film")
    os.kill(os.getpid(), KEEP_AND_GO)  # By default it would end this process.
    assert (stopping.asked, stopping.leaving) == (True, True)


def test_word_may_be_left_twice(stopping: Stopping) -> None:
    stopping.keep_before_leaving()
    for _ in range(2):
        os.kill(os.getpid(), KEEP_AND_GO)
    assert stopping.leaving
