"""Workers for each GPU of this machine, which share out all of them among jobs of 1, 2, 4, … GPUs, and parts
of them among jobs that share a GPU: `python -m worker.fleet`. Or a worker for each of the named devices, each
for jobs of as many GPUs as it has: `… cpu cpu`, `… gpu:0,1 gpu:2,3`.
"""

import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import structlog

from core.configuration import stopping_if_misconfigured
from core.devices import device_name, gpu_indices
from core.errors import EXIT_STATUS, Misconfigured
from core.settings import WorkerSettings
from core.telemetry import configure_logging
from core.variables import variable
from worker.host.child import launch
from worker.host.device import REMEDY, visible_gpus
from worker.host.health import begin_fleet

log = structlog.get_logger()

COMMAND = [sys.executable, "-m", "worker.main"]
_POLL_S = 0.1
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.25, 30.0


@dataclass
class Member:
    """A worker on a device or several GPUs. The pause grows each time it ends soon after its start.

    alive_file: the file it touches, for a health check. pool: the GPUs that it shares out with the others.
    seat: which of the workers of its GPU it is; None where there is one. has_lived: whether it ever ran for
    long.
    """

    device: str
    alive_file: Path | None = None
    pool: str | None = None
    seat: int | None = None
    has_lived: bool = False
    child: subprocess.Popen[bytes] | None = None
    started_at: float = 0.0
    start_at: float = 0.0
    pause_s: float = _FIRST_PAUSE_S

    def look_after(self) -> None:
        """Start it if that is due.

        Raises Misconfigured if it has been misconfigured from the start. If it ever worked, something has
        changed, perhaps for this device alone: the others' jobs continue, and it is started again.
        """
        now = time.monotonic()
        if self.child is None:
            if now >= self.start_at:
                self._start(now)
            return
        if (status := self.child.poll()) is None:
            return
        if now - self.started_at > _LONGEST_PAUSE_S:
            self.has_lived, self.pause_s = True, _FIRST_PAUSE_S
        if status == EXIT_STATUS and not self.has_lived:
            raise Misconfigured(f"The worker on {self.device} cannot work as it is set up; it has said why.")
        log.warning("worker_ended", device=self.device, status=status, again_in_s=self.pause_s)
        self.child, self.start_at = None, now + self.pause_s
        self.pause_s = min(2 * self.pause_s, _LONGEST_PAUSE_S)

    def _start(self, now: float) -> None:
        self.started_at = now
        # In a session of its own: Ctrl-C in a terminal is ours to pass on, once.
        self.child = launch(COMMAND, self._variables(), stdout=None, stderr=None)

    def _variables(self) -> dict[str, str]:
        own = {
            "device": self.device,
            "alive_file": self.alive_file,
            "pool": self.pool,
            "seat": self.seat,
        }
        outer = {name: value for name, value in os.environ.items() if name not in map(variable, own)}
        return outer | {variable(name): str(value) for name, value in own.items() if value is not None}


def members_on(devices: Sequence[str], pool: str | None = None, seats: int = 1) -> list[Member]:
    """One for each seat on each device, with a sign of life of its own where GAITWAY_ALIVE_FILE is set."""
    places = [(device, seat if seats > 1 else None) for device in devices for seat in range(seats)]
    file = os.environ.get(variable("alive_file"))
    signs = begin_fleet(Path(file), len(places)) if file else [None] * len(places)
    return [Member(device, sign, pool, seat) for (device, seat), sign in zip(places, signs, strict=True)]


def serve(members: Sequence[Member]) -> None:
    """Keep them running until a SIGTERM or SIGINT, then let them drain.

    Call it from the main thread: the kernel signals the workers when the thread that started them ends.
    """
    told: list[int] = []
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda number, _: told.append(number))
    try:
        while not told:
            for member in members:
                member.look_after()
            time.sleep(_POLL_S)
    finally:
        running = [member.child for member in members if member.child is not None]
        for child in running:
            child.terminate()
        for child in running:
            child.wait()


@stopping_if_misconfigured()
def main(devices: Sequence[str]) -> None:
    """Serve until a SIGTERM."""
    configure_logging("fleet")
    pool = None if devices else _pool()
    seats = _seats() if pool else 1
    devices = devices or [device_name([gpu]) for gpu in gpu_indices(pool or "cpu")]
    if len(devices) > 1 and os.environ.get(variable("hosts"), "1") != "1":
        raise Misconfigured(
            f"{variable('hosts')} is for one worker with all GPUs of its host, and a fleet has one for each "
            f"GPU: run `python -m worker.main` with {variable('device')}=gpu:0-3, or the like."
        )
    if not devices:
        raise Misconfigured(
            f"No NVIDIA GPU is visible here, and a fleet is one worker for each. {REMEDY}. "
            "For a worker on the CPU run `python -m worker.main`."
        )
    if twice := [gpu for gpu, number in Counter(chain(*map(gpu_indices, devices))).items() if number > 1]:
        raise Misconfigured(
            f"The fleet {' '.join(devices)} has GPU {twice[0]} twice; its jobs would keep each other "
            "waiting. Name each GPU once."
        )
    log.info("fleet_started", devices=devices)
    is_shared = len(devices) > 1 or seats > 1
    serve(members_on(devices, pool if is_shared else None, seats))


def _pool() -> str | None:
    """All GPUs that GAITWAY_POOL names; by default those of the machine. None if there is none."""
    named = os.environ.get(variable("pool"))
    gpus = gpu_indices(named) if named else range(len(visible_gpus()))
    return device_name(gpus) if gpus else None


def _seats() -> int:
    """How many jobs may share a GPU. Raises Misconfigured, as each worker would."""
    default = WorkerSettings.model_fields["seats"].default
    said = os.environ.get(variable("seats"), str(default))
    if not said.isdecimal() or int(said) < 1:
        raise Misconfigured(
            f"{variable('seats')}={said} is no number of jobs that may share a GPU, such as 2."
        )
    return int(said)


if __name__ == "__main__":
    main(sys.argv[1:])
