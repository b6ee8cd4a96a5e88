"""Two hosts that share a job, both on this machine: a supervisor, and a member's worker in a thread."""

import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from core.jobs.job import Job
from core.jobs.store import JobStore
from tests.faults.bench import PROBE, Bench, unused_servers, wait_until
from worker.gang.members import Gang
from worker.gang.place import Place
from worker.host.child import TRAINING
from worker.host.device_health import DeviceHealth
from worker.stopping import Draining
from worker.supervision.member import GangMember
from worker.supervision.supervisor import Supervisor

SECRET = b"a secret of both"
ON_TWO: dict[str, Any] = {"resources": {"accelerator": "cpu", "hosts": 2}}


def probe(behaviour: str) -> Sequence[str]:
    return (sys.executable, str(PROBE), behaviour)


class TwoHosts:
    """second: the training process of the second host; `TRAINING`, or a probe. devices: of each."""

    def __init__(
        self,
        folder: Path,
        store: JobStore,
        second: Sequence[str] = TRAINING,
        devices: tuple[str, str] = ("cpu", "cpu"),
    ) -> None:
        self.bench = Bench(folder / "first", store)
        self.devices = devices
        self.gang = Gang(Place(2, 0, "127.0.0.1", 0, SECRET), devices[0])
        self.draining = Draining()
        self._folder, self._second = folder / "second", second
        self._folder.mkdir(parents=True)
        self._thread = threading.Thread(target=self.member().serve)
        self._thread.start()

    @property
    def lock_of_the_second(self) -> Path:
        """That of the second host's device: who holds it keeps the part there from starting."""
        return self._folder / "locks" / "slot-of-the-second.lock"

    def member(self, secret: bytes = SECRET, rank: int = 1) -> GangMember:
        return GangMember(
            Place(2, rank, "127.0.0.1", self.gang.port, secret),
            unused_servers(self._folder),
            self.devices[1],
            ("slot-of-the-second",),
            self.bench.objects,
            DeviceHealth(self.devices[1], self._folder, ("slot-of-the-second",), None),
            self.draining,
            tuple(self._second),
        )

    def supervisor(self, job: Job, command: Sequence[str] = TRAINING) -> Supervisor:
        """That of the job's next attempt, once both hosts are there."""
        wait_until(self.gang.look)
        claim = self.bench.claim(job)
        device = self.devices[0]
        return Supervisor(claim, self.bench.settings, device, ("slot",), command, gang=self.gang)

    def run(self, job: Job, command: Sequence[str] = TRAINING) -> Job:
        """The job after its next attempt."""
        self.supervisor(job, command).run()
        self.gang.release()
        return self.bench.store.get(job.id)

    def close(self) -> None:
        self.draining.set()
        self.gang.close()
        self._thread.join(30)
        assert not self._thread.is_alive()
