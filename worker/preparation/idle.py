"""Starts the preparation while a worker has nothing to do, and ends it as soon as a job comes."""

import os
import subprocess
import sys
from collections.abc import Sequence

from worker.host.child import kill, launch
from worker.host.device_lock import slot_names

PREPARATION = (sys.executable, "-m", "worker.preparation")


class IdlePreparation:
    """The preparation of one worker's device. environments: those to prepare; none: it does nothing."""

    def __init__(
        self, device: str, environments: Sequence[str], command: Sequence[str] = PREPARATION
    ) -> None:
        self._device, self._command = device, command
        self._has_ended = not environments
        self._child: subprocess.Popen[bytes] | None = None

    def go_on(self) -> None:
        """Start it, unless it runs or has ended. Call it while the worker waits for a job."""
        if self._child is not None:
            self._has_ended = self._child.poll() is not None
        elif not self._has_ended:
            names = slot_names(self._device, os.getpid())
            self._child = launch([*self._command, self._device, *names], os.environ, stdout=None, stderr=None)

    def stop(self) -> None:
        """End it with all its processes; the next `go_on` starts it again, unless it had come to its end."""
        if self._child is not None:
            self._has_ended = self._child.poll() is not None
            kill(self._child)
            self._child = None
