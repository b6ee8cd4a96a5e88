"""Becomes a part of the service that the kernel ends with its world: `member COMMAND ...`."""

import os
import sys

from worker.host.processes import die_with_parent

if __name__ == "__main__":
    die_with_parent()
    os.execv(sys.argv[1], sys.argv[1:])  # noqa: S606
