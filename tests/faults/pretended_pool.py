"""A real fleet on a machine with four pretended GPUs; its trainings are probes.

`python -m tests.faults.pretended_pool` is `worker.fleet`, and with `member` a worker that it starts.
"""

import os
import sys
from functools import partial

from worker.host import device, device_health

device.visible_gpus = lambda dev=device.DEV: [f"nvidia{number}" for number in range(4)]  # type: ignore[misc]
# Several GPUs fail together while this file is there.
_APART = f"{os.environ['PROBE_WAITS_FOR']}/fail-together"
_TEST = f"echo '{device_health.EACH_WORKS}'; test ! -e {_APART} || {{ echo 'NCCL error.'; exit 1; }}"
device_health.command_for = lambda device: (  # type: ignore[assignment]
    ("/bin/sh", "-c", _TEST) if "," in device else ("/bin/true",)
)

import worker.fleet  # noqa: E402 # After what is pretended.
import worker.main  # noqa: E402
import worker.tasks  # noqa: E402
from tests.faults.bench import PROBE  # noqa: E402
from worker.supervision.supervisor import Supervisor  # noqa: E402

if __name__ == "__main__":
    if sys.argv[1:] == ["member"]:
        probe = (sys.executable, str(PROBE), "waits_for_its_job")
        worker.main.device_memory = lambda device, limit: 16 * 2**30  # type: ignore[assignment]
        worker.tasks.Supervisor = partial(Supervisor, command=probe)  # type: ignore[misc,assignment]
        worker.main.main()
    else:
        worker.fleet.COMMAND = [sys.executable, "-m", "tests.faults.pretended_pool", "member"]
        worker.fleet.main([])
