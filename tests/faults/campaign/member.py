"""Becomes a part of the service that the kernel ends with its world: `member PARENT_PID COMMAND ...`."""

import os
import sys

from worker.host.parent_death import die_with_parent

if __name__ == "__main__":
    die_with_parent(int(sys.argv[1]))
    os.execv(sys.argv[2], sys.argv[2:])  # noqa: S606
