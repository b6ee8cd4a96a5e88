"""Ties a process's life to its parent's."""

import ctypes
import os
import signal
import sys

_PR_SET_PDEATHSIG = 1


def die_with_parent(
    expected_parent_pid: int | None = None, signal_number: signal.Signals = signal.SIGKILL
) -> None:
    """From now on the kernel sends us this signal when our parent dies; does nothing except on Linux.

    expected_parent_pid: who started this process. If that one has died before this call, the process
    ends at once. Linux means the parent's *thread*: start children from one that lives as long.
    """
    if sys.platform != "linux":
        return
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_PDEATHSIG, signal_number, 0, 0, 0) != 0:
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code))
    if expected_parent_pid is not None and os.getppid() != expected_parent_pid:
        os.kill(os.getpid(), signal_number)
