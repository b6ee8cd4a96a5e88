"""The real worker with the probe as its training, on a device that works while a file is there."""

import sys
from functools import partial

import worker.main
import worker.tasks
from tests.faults.bench import PROBE
from worker.host import device_health
from worker.host.device_health import DeviceHealth
from worker.supervision.supervisor import Supervisor

if __name__ == "__main__":
    behaviour, file = sys.argv[1:]
    test = ("/bin/sh", "-c", f"test -e {file} || {{ echo 'gpu:0 has fallen off the bus.'; exit 1; }}")
    device_health.command_for = lambda device: test  # type: ignore[assignment]
    worker.main.DeviceHealth = partial(DeviceHealth, pauses_s=(0.2,))  # type: ignore[misc,assignment]
    probe = (sys.executable, str(PROBE), behaviour)
    worker.tasks.Supervisor = partial(Supervisor, command=probe)  # type: ignore[misc,assignment]
    worker.main.main()
