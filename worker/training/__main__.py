"""`python -m worker.training SPOOL EVENTS_FD`, started by the supervisor."""

import json
import os
import signal
import sys
from pathlib import Path
from typing import Any

from core.start_up import start_lean
from worker.confinement.own_files import keep_to_own_files
from worker.host.processes import die_with_parent
from worker.stopping import StopRequest


def main() -> None:
    spool, events_fd = Path(sys.argv[1]), int(sys.argv[2])
    task = _task(spool)
    if task.get("model"):
        keep_to_own_files(spool)
    die_with_parent()
    stopping = StopRequest()
    if (task.get("gang") or {}).get("rank"):
        stopping.is_the_leaders()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    start_lean()
    # Sent before anything heavy is imported: from here on the job is known to run.
    os.write(events_fd, json.dumps({"type": "hello", "pid": os.getpid()}).encode() + b"\n")
    from worker.training.hosts import leave  # Imports JAX.
    from worker.training.run import run

    leave(run(spool, events_fd, stopping))


def _task(spool: Path) -> dict[str, Any]:
    """Read before any thread starts, which would not be confined; `run` validates it."""
    try:
        return json.loads((spool / "task.json").read_bytes())
    except (OSError, ValueError):
        return {}


if __name__ == "__main__":
    main()
