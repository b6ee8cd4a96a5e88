"""The real worker, whose training process is the probe: `python -m tests.faults.probe_worker BEHAVIOUR …`.

Further arguments are packages that this worker does not find.
"""

import sys
from functools import partial

import worker.tasks
from tests.faults.bench import PROBE
from worker.main import main
from worker.supervision.supervisor import Supervisor

if __name__ == "__main__":
    sys.modules.update(dict.fromkeys(sys.argv[2:]))  # type: ignore[arg-type] # How Python notes that there is none.
    probe = (sys.executable, str(PROBE), sys.argv[1])
    worker.tasks.Supervisor = partial(Supervisor, command=probe)  # type: ignore[misc,assignment]
    main()
