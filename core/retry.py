"""Waits, for an unavailable store or for a given time, that can be called off."""

import time
from collections.abc import Callable
from typing import TypeVar

import structlog

from core.errors import Unavailable

log = structlog.get_logger()

Result = TypeVar("Result")

_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.1, 5.0
# How often a wait checks whether it has been called off.
_POLL_S = 0.1
# How often the log repeats what is waited for.
_LOG_AGAIN_AFTER_S = 60.0


class CalledOff(Exception):
    """The wait was called off."""


def _never() -> bool:
    return False


def retry_while_unavailable(
    step: Callable[[], Result],
    timeout_s: float = float("inf"),
    gives_up_on: tuple[type[Unavailable], ...] = (),
    called_off: Callable[[], bool] = _never,
) -> Result:
    """The step's result; the step is repeated while it raises Unavailable.

    Raises Unavailable after `timeout_s`; an error in `gives_up_on`, or any other error of the step, at once;
    CalledOff if `called_off` becomes true during the wait.
    """
    deadline, pause_s = time.monotonic() + timeout_s, _FIRST_PAUSE_S
    said, said_at = "", 0.0
    while True:
        try:
            return step()
        except gives_up_on:
            raise
        except Unavailable as error:
            now = time.monotonic()
            if now > deadline:
                raise
            if error.detail != said or now - said_at >= _LOG_AGAIN_AFTER_S:
                log.warning("bookkeeping_waits", error=error.detail)
                said, said_at = error.detail, now
        pause(pause_s, called_off)
        pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)


def pause(seconds: float, called_off: Callable[[], bool] = _never) -> None:
    """Sleep for `seconds`. Raises CalledOff as soon as `called_off` is true.

    Polls instead of waiting on a threading.Event: see worker/stopping.py.
    """
    until = time.monotonic() + seconds
    while not called_off():
        left_s = until - time.monotonic()
        if left_s <= 0:
            return
        time.sleep(min(left_s, _POLL_S))
    raise CalledOff
