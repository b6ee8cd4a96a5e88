"""The logs of a process: lines of JSON on stdout."""

import logging
import sys
from collections.abc import MutableMapping
from typing import Any

import structlog


def configure_logging(service: str, **always: object) -> None:
    """Log JSON from here on.

    Each line has the service's name, `always`, and whatever is bound to the context. A thread begins with an
    empty context: what all lines of a process must have belongs into `always`; what is None is left out.
    """
    common = {"service": service, **{name: value for name, value in always.items() if value is not None}}

    def add_common(_: object, __: str, event: MutableMapping[str, Any]) -> MutableMapping[str, Any]:
        return {**common, **event}

    structlog.configure(
        processors=[
            add_common,
            structlog.contextvars.merge_contextvars,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            structlog.processors.format_exc_info,
            structlog.processors.JSONRenderer(),
        ],
        wrapper_class=structlog.make_filtering_bound_logger(logging.INFO),
        logger_factory=structlog.PrintLoggerFactory(sys.stdout),
    )
