"""Waiting: for a store that is away, or for a while, unless somebody calls it off."""

import time
from collections.abc import Callable
from typing import TypeVar

import structlog

from core.errors import Unavailable

log = structlog.get_logger()

Result = TypeVar("Result")

_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.1, 5.0
# How often a wait looks whether it has been called off.
_GLANCE_S = 0.1
# After so long the log says once more what is waited for.
_SAY_AGAIN_AFTER_S = 60.0


class CalledOff(Exception):
    """What was waited for is no longer wanted."""


def _never() -> bool:
    return False


def retry_while_unavailable(
    step: Callable[[], Result],
    patience_s: float = float("inf"),
    gives_up_on: tuple[type[Unavailable], ...] = (),
    called_off: Callable[[], bool] = _never,
) -> Result:
    """What the step returns, tried again and again while a store is away.

    Raises Unavailable once it has been away for `patience_s`, and at once what is in `gives_up_on` and
    whatever else the step raises; CalledOff where the store is away and nobody wants to wait any more.
    """
    deadline, pause_s = time.monotonic() + patience_s, _FIRST_PAUSE_S
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
            if error.detail != said or now - said_at >= _SAY_AGAIN_AFTER_S:
                log.warning("bookkeeping_waits", error=error.detail)
                said, said_at = error.detail, now
        pause(pause_s, called_off)
        pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)


def pause(seconds: float, called_off: Callable[[], bool] = _never) -> None:
    """Sleep so long. Raises CalledOff as soon as that is so.

    It looks again and again rather than to wait for a threading.Event: see worker/host/drain_flag.py.
    """
    until = time.monotonic() + seconds
    while not called_off():
        left_s = until - time.monotonic()
        if left_s <= 0:
            return
        time.sleep(min(left_s, _GLANCE_S))
    raise CalledOff
