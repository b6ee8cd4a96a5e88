"""Waits for a state of a service."""

import time
from collections.abc import Callable


def until(holds: Callable[[], bool], timeout_s: float = 300.0) -> None:
    """Return once the condition holds, checked ten times a second. Raises TimeoutError."""
    deadline = time.monotonic() + timeout_s
    while not holds():
        if time.monotonic() > deadline:
            raise TimeoutError(f"The condition did not hold within {timeout_s:.0f} s.")
        time.sleep(0.1)
