"""Starts the preparation while a worker has nothing to do, and ends it as soon as a job comes."""

import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from core.variables import PREFIX, variable
from worker.host.child import environment, kill, launch
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
            command = [*self._command, self._device, *names]
            self._child = launch(command, _variables(self._device, os.environ), stdout=None, stderr=None)

    def stop(self) -> None:
        """End it with all its processes; the next `go_on` starts it again, unless it had come to its end."""
        if self._child is not None:
            self._has_ended = self._child.poll() is not None
            kill(self._child)
            self._child = None


def _variables(device: str, base: Mapping[str, str]) -> dict[str, str]:
    """Those of a training, and the service's own settings: it shares what it compiles by the object store."""
    scrubbed = environment(device, Path(base.get(variable("data_dir"), "")), base)
    del scrubbed[variable("data_dir")]
    own = {name: value for name, value in base.items() if name.startswith(PREFIX)}
    own.pop(variable("wandb_api_key"), None)
    return {**scrubbed, **own}
