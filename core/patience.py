"""Doing something through an outage."""

import time
from collections.abc import Callable
from typing import TypeVar

import structlog

from core.errors import Unavailable

log = structlog.get_logger()

Result = TypeVar("Result")

_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.1, 5.0


def through_outages(
    step: Callable[[], Result],
    patience_s: float = float("inf"),
    gives_up_on: tuple[type[Unavailable], ...] = (),
) -> Result:
    """What the step returns, tried again and again while a store is away.

    Raises Unavailable once it has been away for `patience_s`, and at once what is in `gives_up_on` and
    whatever else the step raises.
    """
    deadline, pause_s = time.monotonic() + patience_s, _FIRST_PAUSE_S
    while True:
        try:
            return step()
        except gives_up_on:
            raise
        except Unavailable as error:
            if time.monotonic() > deadline:
                raise
            log.warning("bookkeeping_waits", error=error.detail)
            time.sleep(pause_s)
            pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)
