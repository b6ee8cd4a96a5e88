"""`python -m worker.preparation DEVICE SLOT…`: compile what GAITWAY_PREPARE names, once on this machine.

A worker starts it while it has no job, and kills it when one comes.
"""

import os
import sys
from pathlib import Path

from core.adapters.wiring import object_store
from core.configuration import read
from core.settings import WorkerSettings
from core.telemetry import configure_logging
from worker.host.locks import slots
from worker.host.processes import die_with_parent
from worker.preparation.programs import prepare

# The service, and whoever works on this machine, go first.
_NICENESS = 19
# Whoever looks whether a lock can go holds it for a moment.
_LOCKED_S = 5.0


def main() -> None:
    die_with_parent()
    os.nice(_NICENESS)
    configure_logging("preparation")
    device, names = sys.argv[1], sys.argv[2:]
    settings = read(WorkerSettings)
    locks = [Path(settings.data_dir, "locks", f"{name}.lock").absolute() for name in names]
    with slots(locks, _LOCKED_S) as slot_fds:
        for environment in settings.prepared:
            prepare(environment, settings, object_store(settings), device, slot_fds)


if __name__ == "__main__":
    main()
