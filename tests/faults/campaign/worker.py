"""The real worker (`python -m tests.faults.campaign.worker`) with the training process of this campaign."""

import sys
from functools import partial
from pathlib import Path

from worker import main, tasks
from worker.supervision.supervisor import Supervisor

COMMAND = (sys.executable, str(Path(__file__).with_name("training.py")))

if __name__ == "__main__":
    tasks.Supervisor = partial(Supervisor, command=COMMAND)  # type: ignore[misc, assignment]
    main.main()
