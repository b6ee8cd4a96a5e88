"""Tests whether a worker's device works: before the first job, and after a failure that it may have caused.

A device that fails is set aside: its worker takes no job until the device passes a later test. So is one that
another process still holds, until that has ended.
"""

import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path

import structlog

from core.devices import gpu_indices
from core.jobs.workers import WorkerState
from core.reasons import Reason
from core.retry import CalledOff, pause
from worker.host.child import environment, kill, launch, tail
from worker.host.locks import SlotTaken, slots

log = structlog.get_logger()

# After an attempt that ended for one of these reasons, the device is tested before it is used again.
SUSPICIOUS = frozenset({Reason.NATIVE_CRASH, Reason.DEVICE_FAILED, Reason.TRAINING_STALLED})
# What the test prints before it tries several cards together.
EACH_WORKS = "Each card works; now all together."
# JAX and CUDA take some 10 s to start on a machine that has just been started.
_TEST_S = 60.0
_POLL_S = 0.1
# From each failed test to the next; the last value repeats.
_PAUSES_S = (60.0, 300.0, 900.0)


def command_for(device: str) -> tuple[str, ...] | None:
    """The program that tests a device; None for a CPU, which runs this code already."""
    gpus = gpu_indices(device)
    return (sys.executable, "-m", "worker.training.device_test", str(len(gpus))) if gpus else None


class DeviceTest:
    """A child process that tests the device, started at once. fds: inherited by it, to hold the locks.

    each_works: once the problem is known, whether each of several cards works, and only all together do not.
    """

    def __init__(
        self,
        command: Sequence[str],
        device: str,
        data_dir: Path,
        fds: Sequence[int] = (),
        limit_s: float = _TEST_S,
    ) -> None:
        self._device, self._limit_s = device, limit_s
        self._deadline = time.monotonic() + limit_s
        self.each_works = False
        self._said = tempfile.TemporaryFile()  # noqa: SIM115 # `close` does.
        variables = environment(device, data_dir, os.environ)
        self._child = launch(command, variables, stdout=self._said, fds=fds)

    def is_over(self) -> bool:
        """Whether there is a result."""
        return self._child.poll() is not None or time.monotonic() > self._deadline

    def problem(self) -> str | None:
        """A sentence that says what is wrong with the device, or None. Call it when the test is over."""
        status, lines = self._child.poll(), tail(self._said, 2**16).split("\n")
        self.close()
        last_line = next((line.strip()[:500] for line in reversed(lines) if line.strip()), "it said nothing.")
        self.each_works = EACH_WORKS in lines
        if status == 0:
            return None
        if status is None:
            return f"A test of the device {self._device} did not end within {self._limit_s:g} s."
        ending = f"was ended by {signal.Signals(-status).name}" if status < 0 else f"failed (status {status})"
        return f"A test of the device {self._device} {ending}: {last_line}"

    def close(self) -> None:
        """End the process. One that hangs in a driver ends when the driver returns."""
        kill(self._child, 5.0)
        self._said.close()


def result_of(test: DeviceTest, called_off: Callable[[], bool]) -> str | None:
    """A sentence that says what is wrong with the device; None also if the test was called off."""
    try:
        while not test.is_over():
            pause(_POLL_S, called_off)
    except CalledOff:
        test.close()
        return None
    return test.problem()


def mark_of(data_dir: Path, slot_name: str) -> Path:
    """The file in which an attempt reports to its worker what is wrong with the device."""
    return data_dir / "devices" / f"{slot_name}.failed"


def set_aside(data_dir: Path, slot_names: Iterable[str], problem: str) -> None:
    """Report the problem to the devices' workers, which read the files before they take another job."""
    for name in slot_names:
        mark = mark_of(data_dir, name)
        mark.parent.mkdir(parents=True, exist_ok=True)
        mark.write_text(problem)


def _passed_mark(data_dir: Path, slot_name: str) -> Path:
    """The file that is there while a device has passed its last test."""
    return data_dir / "devices" / f"{slot_name}.passed"


class SeatHealth:
    """What a worker of a further seat on a GPU knows of it: that of the first seat tests it."""

    def __init__(self, data_dir: Path, slot_name: str) -> None:
        self._mark, self._passed = mark_of(data_dir, slot_name), _passed_mark(data_dir, slot_name)
        self.state: WorkerState = "testing"
        self.problem: str | None = None

    def is_fit(self) -> bool:
        """Whether the worker may take a job."""
        try:
            self.state, self.problem = "device_failed", self._mark.read_text()
        except OSError:
            self.state, self.problem = "ready" if self._passed.exists() else "testing", None
        return self.state == "ready"

    def close(self) -> None:
        """Nothing runs."""


class DeviceHealth:
    """A worker's knowledge of its device. command: the test; None if the device works once nobody holds it.

    slot_names: the device's locks, which are held during a test.
    """

    def __init__(
        self,
        device: str,
        data_dir: Path,
        slot_names: Sequence[str],
        command: Sequence[str] | None,
        pauses_s: Sequence[float] = _PAUSES_S,
    ) -> None:
        self.state: WorkerState = "ready" if command is None else "testing"
        self.problem: str | None = None
        self._device, self._data_dir, self._command = device, data_dir, command
        self._locks = [data_dir / "locks" / f"{name}.lock" for name in slot_names]
        self._slot_names = tuple(slot_names)
        self._marks = [mark_of(data_dir, name) for name in slot_names]
        self._passed = [_passed_mark(data_dir, name) for name in slot_names]
        self._pauses_s = pauses_s
        self._num_failures = 0
        self._test_at = 0.0
        self._test: DeviceTest | None = None
        self._held = ExitStack()
        if command is not None:  # What an earlier worker found is not known of this device now.
            self._forget_passed()

    def is_fit(self) -> bool:
        """Whether the worker may take a job. Call it repeatedly: each call does a little and none waits."""
        said = [mark.read_text() for mark in self._marks if mark.exists()] if self.state == "ready" else []
        if said:
            self._fail(said[0])
        if self._test is not None:
            self._look(self._test)
        elif self.state != "ready" and time.monotonic() >= self._test_at:
            self._begin()
        return self.state == "ready"

    def close(self) -> None:
        """End a running test."""
        if self._test is not None:
            self._test.close()
            self._test = None
        self._held.close()

    def _begin(self) -> None:
        try:
            fds = self._held.enter_context(slots(self._locks, 0.0))
        except SlotTaken:  # The training of a worker that was killed is still ending.
            return
        if self._command is None:
            self._works()
            return
        self._test = DeviceTest(self._command, self._device, self._data_dir, fds)

    def _look(self, test: DeviceTest) -> None:
        if not test.is_over():
            return
        problem = test.problem()
        self.close()
        if problem is not None:
            self._fail(problem)
            return
        self._works()

    def _works(self) -> None:
        self._held.close()
        for mark in self._marks:
            mark.unlink(missing_ok=True)
        for passed in self._passed:
            passed.parent.mkdir(parents=True, exist_ok=True)
            passed.touch()
        self.state, self.problem, self._num_failures = "ready", None, 0
        log.info("device_works", device=self._device)

    def _fail(self, problem: str) -> None:
        pause_s = self._pauses_s[min(self._num_failures, len(self._pauses_s) - 1)]
        self._num_failures += 1
        self.state, self.problem = "device_failed", problem
        self._forget_passed()
        with suppress(OSError):  # Other workers of its pool see by it that it does not work.
            set_aside(self._data_dir, self._slot_names, problem)
        self._test_at = time.monotonic() + pause_s
        log.error("device_set_aside", device=self._device, detail=problem, tested_again_in_s=pause_s)

    def _forget_passed(self) -> None:
        for passed in self._passed:
            passed.unlink(missing_ok=True)
