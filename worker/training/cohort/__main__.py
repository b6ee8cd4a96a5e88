"""`python -m worker.training.cohort FD...`, started by the worker. FD: of each member's connection."""

import signal
import sys
from multiprocessing.connection import Connection

from worker.host.parent_death import die_with_parent


def main() -> None:
    die_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    from worker.training.cohort.serve import serve  # Imports JAX.

    serve([Connection(int(descriptor)) for descriptor in sys.argv[1:]])


if __name__ == "__main__":
    main()
