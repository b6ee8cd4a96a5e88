"""Compiles an environment's default training before a job asks for it: by one short training.

It has the programs of the whole one: how many steps it takes is an argument of them. What it trains goes. A
worker starts it while it has nothing to do, and ends it as soon as a job comes.
"""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import IO

import structlog

from core.jobs.spec import TrainSpec
from core.settings import WorkerSettings
from core.storage.objects import ObjectStore
from core.variables import PREFIX, variable
from worker.compile_cache.fingerprint import fingerprint
from worker.compile_cache.session import Caches, cached_as
from worker.host.child import TRAINING, environment, kill, launch, tail
from worker.host.locks import slot_names
from worker.host.memory import sacrifice
from worker.protocol import Task
from worker.supervision.spool import SPOOLS, private, spool

log = structlog.get_logger()

# In GAITWAY_DATA_DIR; holds a file for each environment that has been prepared here.
PREPARED = "prepared"
# Drawing is nothing that is compiled: as few and small pictures as there may be.
_VIDEO = {"width": 64, "height": 64, "fps": 1}
# After a failure, such as a lock that somebody had, it is tried again so much later.
_AGAIN_S = 60.0
PREPARATION = (sys.executable, "-m", "worker.preparation")


def prepare(
    environment_id: str,
    settings: WorkerSettings,
    objects: ObjectStore,
    device: str,
    slot_fds: Sequence[int] = (),
    command: Sequence[str] = TRAINING,
) -> None:
    """Compile it, unless that was done here before; a failure is logged, and tried again at the next start.

    slot_fds: of the device's locks. command: the training's program.
    """
    folder, task = settings.data_dir.absolute(), _task(environment_id, device)
    chosen = task.spec.environment
    name = f"{cached_as(chosen)}-{version('gaitway')}-{fingerprint(device)}"
    done, own = folder / PREPARED / name, folder / SPOOLS / f"prepare-{name}"
    # One of the workers with equal devices prepares; the others wait for its spool.
    with spool(own), tempfile.TemporaryFile() as output:
        if done.exists():
            return
        caches = Caches(objects, settings, device, own, private(own))
        caches.open(chosen, _never)
        (own / "task.json").write_text(task.model_dump_json())
        variables = {**environment(device, folder, os.environ), variable("models"): settings.models}
        pipes = (output.fileno(), *slot_fds)
        child = launch(
            [*command, str(own), str(output.fileno())],
            variables,
            stdout=subprocess.DEVNULL,
            cwd=own,
            fds=pipes,
        )
        sacrifice(child.pid)
        if status := child.wait():
            log.warning("not_prepared", environment=environment_id, status=status, detail=_last_line(output))
            return
        caches.keep()
        caches.close(_never)
        done.parent.mkdir(exist_ok=True)
        done.touch()
    log.info("prepared", environment=environment_id)


def _task(environment_id: str, device: str) -> Task:
    document = {"environment": environment_id, "algorithm": {"num_timesteps": 1}, "video": _VIDEO}
    return Task(job_id="preparation", attempt=1, spec=TrainSpec.model_validate(document), device=device)


def _last_line(output: IO[bytes]) -> str:
    return tail(output, 2**12).rstrip().rpartition("\n")[2]


def _never() -> bool:
    return False


class IdlePreparation:
    """The preparation of one worker's device. environments: those to prepare; none: it does nothing.

    clock: seconds.
    """

    def __init__(
        self,
        device: str,
        environments: Sequence[str],
        command: Sequence[str] = PREPARATION,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._device, self._command, self._clock = device, command, clock
        self._has_ended = not environments
        self._child: subprocess.Popen[bytes] | None = None
        self._not_before = 0.0

    def go_on(self) -> None:
        """Start it, unless it runs or has ended, or failed just now. Call it while the worker waits."""
        if self._child is not None:
            self._look(self._child)
        elif not self._has_ended and self._clock() >= self._not_before:
            names = slot_names(self._device, os.getpid())
            command = [*self._command, self._device, *names]
            self._child = launch(command, _variables(self._device, os.environ), stdout=None, stderr=None)

    @property
    def is_running(self) -> bool:
        """Whether it uses the device."""
        return self._child is not None and self._child.poll() is None

    def stop(self) -> None:
        """End it with all its processes; the next `go_on` starts it again, unless it had come to its end."""
        if self._child is not None:
            self._look(self._child)
        if self._child is not None:
            kill(self._child)
            self._child = None

    def _look(self, child: subprocess.Popen[bytes]) -> None:
        """Note whether it has come to its end, or failed."""
        self._has_ended = child.poll() == 0
        if child.returncode:
            kill(child)
            self._child, self._not_before = None, self._clock() + _AGAIN_S


def _variables(device: str, base: Mapping[str, str]) -> dict[str, str]:
    """Those of a training, and the service's own settings: it shares what it compiles by the object store."""
    scrubbed = environment(device, Path(base.get(variable("data_dir"), "")), base)
    del scrubbed[variable("data_dir")]
    own = {name: value for name, value in base.items() if name.startswith(PREFIX)}
    own.pop(variable("wandb_api_key"), None)
    return {**scrubbed, **own}
