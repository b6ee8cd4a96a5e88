"""Reads the settings from the environment, or says what is wrong with them."""

import os
import sys
from collections.abc import Generator
from contextlib import contextmanager
from difflib import get_close_matches
from pathlib import Path
from typing import TypeVar

import structlog
from pydantic import ValidationError
from pydantic_core import ErrorDetails

from core.errors import EXIT_STATUS, Misconfigured
from core.settings import ApiSettings, ReconcilerSettings, StoreSettings, WorkerSettings
from core.variables import PREFIX, variable

log = structlog.get_logger()

PROCESSES: dict[str, type[StoreSettings]] = {
    "API": ApiSettings,
    "worker": WorkerSettings,
    "reconciler": ReconcilerSettings,
}
SECRETS_DIR = f"{PREFIX}SECRETS_DIR"

AnySettings = TypeVar("AnySettings", bound=StoreSettings)


def read(kind: type[AnySettings]) -> AnySettings:
    """One process's settings. Raises Misconfigured, which names each variable and what to do about it."""
    folder = os.environ.get(SECRETS_DIR) or None
    if folder is not None and not Path(folder).is_dir():
        raise Misconfigured(f"{SECRETS_DIR} names {folder}, which is not a folder.")
    _refuse_typing_errors()
    try:
        return kind(_secrets_dir=folder)  # pyright: ignore[reportCallIssue] # The rest is the environment's.
    except ValidationError as error:
        raise Misconfigured(" ".join(_sentence(kind, detail) for detail in error.errors())) from None


@contextmanager
def stopping_if_misconfigured() -> Generator[None]:
    """Log a Misconfigured error, and exit with status 78."""
    try:
        yield
    except Misconfigured as error:
        log.error("misconfigured", detail=error.detail)
        sys.exit(EXIT_STATUS)


def names() -> set[str]:
    """Every variable that some process reads."""
    return {variable(field) for kind in PROCESSES.values() for field in kind.model_fields}


def _refuse_typing_errors() -> None:
    """Refuse a name that is nearly a setting's; other unknown names belong to other programs."""
    known = names() | {SECRETS_DIR}
    for name in os.environ:
        if name.startswith(PREFIX) and name not in known:
            meant = get_close_matches(name, known, n=1, cutoff=0.9)
            if meant:
                raise Misconfigured(f"There is no setting {name}; did you mean {meant[0]}?")


def _sentence(kind: type[StoreSettings], detail: ErrorDetails) -> str:
    if not detail["loc"]:  # A check of several settings together; its message names them.
        return detail["msg"].removeprefix("Value error, ")
    field = str(detail["loc"][0])
    meaning = kind.model_fields[field].description or ""
    if detail["type"] == "missing":
        return f"{variable(field)} is not set. {meaning}"
    reason = detail["msg"].removeprefix("Value error, ")
    return f"{variable(field)} is wrong: {reason}. {meaning}"
