"""Processes that a signal has stopped are ended, each after its own patience."""

import signal
import subprocess
import sys
from collections.abc import Iterator

import psutil
import pytest

from gaitway.service.embedded.stopped import StoppedProcesses

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="needs a process' state")


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def child() -> Iterator[subprocess.Popen[bytes]]:
    # A grandchild prints once it lives.
    shell = "sleep 600 & echo $!; wait"
    with subprocess.Popen(["sh", "-c", shell], stdout=subprocess.PIPE, start_new_session=True) as process:
        yield process
        process.kill()


def grandchild_of(process: subprocess.Popen[bytes]) -> psutil.Process:
    assert process.stdout is not None
    return psutil.Process(int(process.stdout.readline()))


def stop(process: psutil.Process) -> None:
    process.send_signal(signal.SIGSTOP)
    while process.status() != psutil.STATUS_STOPPED:  # The kernel does it when the process is next on.
        pass


def test_a_stopped_descendant_is_ended_after_its_patience(child: subprocess.Popen[bytes]) -> None:
    clock = Clock()
    watch = StoppedProcesses(max_stopped_s=30, clock=clock)
    sleeper = grandchild_of(child)
    stop(sleeper)
    assert watch.end() == []
    clock.now = 29.9
    assert watch.end() == []
    clock.now = 30.0
    (sentence,) = watch.end()
    assert sentence.endswith(f"(process {sleeper.pid}) was stopped by a signal for 30 s and is ended.")
    assert child.wait(5) == 0  # The shell has seen its child end.


def test_one_that_goes_on_meanwhile_is_left_alone(child: subprocess.Popen[bytes]) -> None:
    clock = Clock()
    watch = StoppedProcesses(max_stopped_s=30, clock=clock)
    sleeper = grandchild_of(child)
    stop(sleeper)
    assert watch.end() == []
    sleeper.resume()
    clock.now = 20.0
    assert watch.end() == []
    stop(sleeper)
    clock.now = 35.0
    assert watch.end() == []  # Stopped anew: its patience begins anew.
    assert sleeper.is_running()
