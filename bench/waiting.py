"""Waiting for what a service will show."""

import time
from collections.abc import Callable


def until(holds: Callable[[], bool], timeout_s: float = 300.0) -> None:
    """Return when it is so, looking ten times a second. Raises TimeoutError."""
    deadline = time.monotonic() + timeout_s
    while not holds():
        if time.monotonic() > deadline:
            raise TimeoutError(f"It was not so within {timeout_s:.0f} s.")
        time.sleep(0.1)
