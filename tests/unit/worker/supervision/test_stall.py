"""When a training process hangs, and when it only takes its time."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path

import pytest

from worker.supervision.watching import StallWatch, is_stopped, stopped_processes

PATIENCE = timedelta(seconds=60)


class Clock:
    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


def watch(clock: Clock, stopped: list[int] | None = None) -> StallWatch:
    return StallWatch(PATIENCE, clock, lambda group: list(stopped or []))


def test_compiling_may_take_an_hour(clock: Clock) -> None:
    seen = watch(clock)
    seen.hear()
    clock.now_s += 3599
    assert seen.what_is_wrong(1) is None
    clock.now_s += 2
    assert seen.what_is_wrong(1) == "The training process said nothing for 3600 s and was ended."


def test_a_run_with_quick_updates_is_ended_after_the_patience(clock: Clock) -> None:
    seen = watch(clock)
    seen.hear(is_progress=True)
    for _ in range(5):
        clock.now_s += 2  # 20 × 2 s are less than the patience of 60 s.
        seen.hear(is_progress=True)
    clock.now_s += 59
    assert seen.what_is_wrong(1) is None
    clock.now_s += 2
    assert seen.what_is_wrong(1) == "The training process said nothing for 60 s and was ended."


def test_a_run_with_slow_updates_gets_twenty_times_its_longest_silence(clock: Clock) -> None:
    seen = watch(clock)
    seen.hear(is_progress=True)
    clock.now_s += 30
    seen.hear(is_progress=True)
    clock.now_s += 599  # 20 × 30 s = 600 s
    assert seen.what_is_wrong(1) is None
    clock.now_s += 2
    assert "600 s" in str(seen.what_is_wrong(1))


def test_a_line_of_the_log_is_a_sign_of_life(clock: Clock) -> None:
    seen = watch(clock)
    seen.hear(is_progress=True)
    clock.now_s += 59
    seen.hear()
    clock.now_s += 59
    assert seen.what_is_wrong(1) is None


def test_a_stopped_process_is_ended_after_a_while_and_not_for_a_moment(clock: Clock) -> None:
    stopped = [77]
    seen = StallWatch(PATIENCE, clock, lambda group: list(stopped))
    for wanted in (None, None, None, 77):
        clock.now_s += 9
        said = seen.what_is_wrong(1)
        assert (said is None) if wanted is None else (f"Process {wanted}" in str(said))
    stopped.clear()
    clock.now_s += 9
    assert seen.what_is_wrong(1) is None
    stopped.append(78)
    clock.now_s += 9
    assert seen.what_is_wrong(1) is None


@pytest.fixture
def sleeper() -> Iterator["subprocess.Popen[bytes]"]:
    """A process in a group of its own."""
    command = [sys.executable, "-c", "import sys, time; print(flush=True); time.sleep(60)"]
    with subprocess.Popen(command, start_new_session=True, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        yield process
        process.kill()


@pytest.mark.skipif(sys.platform != "linux", reason="there is no /proc")
def test_stopped_processes_of_a_group_are_found(sleeper: "subprocess.Popen[bytes]") -> None:
    assert stopped_processes(sleeper.pid) == []
    os.kill(sleeper.pid, signal.SIGSTOP)
    os.waitid(os.P_PID, sleeper.pid, os.WSTOPPED | os.WNOWAIT)
    assert stopped_processes(sleeper.pid) == [sleeper.pid]
    assert is_stopped(sleeper.pid)
    assert stopped_processes(os.getpgrp()) == []


def test_a_machine_without_proc_has_no_stopped_processes(tmp_path: Path) -> None:
    assert stopped_processes(1, tmp_path) == []
