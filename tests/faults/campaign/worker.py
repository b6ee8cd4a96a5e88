"""The real worker (`python -m tests.faults.campaign.worker`) with the training process of this campaign.

Jobs that train together have a process between them that only waits until all of them have left.
"""

import sys
from functools import partial
from pathlib import Path

from worker import main, tasks
from worker.supervision.cohort import Cohort
from worker.supervision.supervisor import Supervisor

COMMAND = (sys.executable, str(Path(__file__).with_name("training.py")))
COHORT = (sys.executable, str(Path(__file__).with_name("cohort.py")))

if __name__ == "__main__":
    tasks.Supervisor = partial(Supervisor, command=COMMAND)  # type: ignore[misc, assignment]
    tasks.Cohort = partial(Cohort, command=COHORT, member_command=COMMAND)  # type: ignore[misc, assignment]
    main.main()
