"""The processes of this machine, as Linux shows them, and the tie of a process's life to its parent's."""

import ctypes
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

# Holds the parent's process id; worker/host/child.py sets it.
PARENT = "GAITWAY_PARENT"
_PR_SET_PDEATHSIG = 1


def processes(proc: Path, name: str = "[0-9]*") -> Iterator[tuple[int, str, int]]:
    """Id, state and process group of every process (proc(5))."""
    for path in proc.glob(f"{name}/stat"):
        try:
            # The name, in parentheses, may hold anything; the fields behind it are plain.
            state, _, group = path.read_text().rpartition(")")[2].split()[:3]
        except (OSError, ValueError):  # It has just ended.
            continue
        yield int(path.parent.name), state, int(group)


def die_with_parent(signal_number: signal.Signals = signal.SIGKILL) -> None:
    """From now on the kernel sends us this signal when our parent dies; does nothing except on Linux.

    If the parent that GAITWAY_PARENT names has died before this call, the signal comes at once. The variable
    is removed, so that our own children do not inherit it. Linux means the parent's *thread*: start children
    from one that lives as long.
    """
    parent = os.environ.pop(PARENT, None)
    if sys.platform != "linux":
        return
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_PDEATHSIG, signal_number, 0, 0, 0) != 0:
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code))
    if parent is not None and os.getppid() != int(parent):
        os.kill(os.getpid(), signal_number)
