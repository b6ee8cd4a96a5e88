"""The real worker, whose training process is the probe: `python -m tests.faults.probe_worker BEHAVIOUR`."""

import sys
from functools import partial

import worker.tasks
from tests.faults.bench import PROBE
from worker.main import main
from worker.supervisor import Supervisor

if __name__ == "__main__":
    probe = (sys.executable, str(PROBE), sys.argv[1])
    worker.tasks.Supervisor = partial(Supervisor, command=probe)  # type: ignore[misc,assignment]
    main()
