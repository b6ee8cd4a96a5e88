"""Processes of the service that share one import of its code, which takes each longer than all else here."""

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.context import ForkServerProcess
from typing import TextIO

_CONTEXT = get_context("forkserver")
_CONTEXT.set_forkserver_preload(["__main__", "worker.main", "worker.reconciler", __name__])


@dataclass(frozen=True)
class Forked:
    """A process with a log to read."""

    process: ForkServerProcess
    log: TextIO

    def end(self, timeout_s: float) -> tuple[int, str]:
        """Its exit status, and what is left of its log."""
        self.process.join(timeout_s)
        assert self.process.exitcode is not None, "it goes on"
        return self.process.exitcode, self.log.read()


@contextmanager
def forked(main: Callable[[], None]) -> Iterator[Forked]:
    """A process that runs this function of a module, in the environment that there is now."""
    ours, theirs = _CONTEXT.Pipe(duplex=False)
    process = _CONTEXT.Process(target=_run, args=(main, dict(os.environ), theirs))
    process.start()
    theirs.close()
    with ours, os.fdopen(os.dup(ours.fileno())) as log:
        try:
            yield Forked(process, log)
        finally:
            process.kill()
            process.join()


def _run(main: Callable[[], None], environment: dict[str, str], log: Connection) -> None:
    os.environ.clear()
    os.environ.update(environment)
    os.dup2(log.fileno(), sys.stdout.fileno())
    main()
