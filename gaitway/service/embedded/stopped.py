"""Ends processes that a signal has stopped: they neither work nor end, so nothing would restart them."""

import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import psutil

# A worker ends its stopped children after 20 s and gives the job back; this is the last resort.
MAX_STOPPED_S = 30.0
_LONGEST_COMMAND = 60


class StoppedProcesses:
    """Watches the descendants of this process. max_stopped_s: how long each may stay stopped.

    A process under a debugger does not count.
    """

    def __init__(
        self, max_stopped_s: float = MAX_STOPPED_S, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._max_stopped_s = max_stopped_s
        self._clock = clock
        self._since: dict[psutil.Process, float] = {}

    def end(self) -> list[str]:
        """Kill those that have been stopped for too long; returns a sentence about each."""
        now = self._clock()
        self._since = {process: self._since.get(process, now) for process in _stopped()}
        return [
            _kill(process, now - since)
            for process, since in self._since.items()
            if now - since >= self._max_stopped_s
        ]


def _stopped() -> list[psutil.Process]:
    return [process for process in psutil.Process().children(recursive=True) if _is_stopped(process)]


def _is_stopped(process: psutil.Process) -> bool:
    with suppress(psutil.NoSuchProcess):
        return process.status() == psutil.STATUS_STOPPED
    return False


def _kill(process: psutil.Process, seconds: float) -> str:
    with suppress(psutil.Error):
        program, *arguments = process.cmdline()
        command = " ".join([Path(program).name, *arguments])[:_LONGEST_COMMAND]
        process.kill()
        return f"{command} (process {process.pid}) was stopped by a signal for {seconds:.0f} s and is ended."
    return f"Process {process.pid} was stopped by a signal and cannot be ended."
