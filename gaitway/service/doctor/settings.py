"""Checks of the environment's settings, read as the service's processes read them."""

import importlib.util
import os
from typing import TYPE_CHECKING, TypeVar

from core.errors import Misconfigured
from gaitway.service.doctor.check import Check

if TYPE_CHECKING:
    from core.settings import StoreSettings, WorkerSettings

AnySettings = TypeVar("AnySettings", bound="StoreSettings")

_CLIENT_ONLY = "the service's packages are not installed; this machine can be a client only"
_NOT_CONFIGURED = "not configured (the embedded stack will start its own)"


def settings() -> Check:
    """Whether the service's processes would start with these settings."""
    if not _is_installed():
        return Check("settings", "skip", _CLIENT_ONLY)
    if not _is_configured():
        return Check("settings", "skip", _NOT_CONFIGURED)
    problems = _problems()
    if problems:
        return Check("settings", "fail", " ".join(problems))
    return Check("settings", "pass", "complete")


def of_the_stores() -> "StoreSettings | None":
    """The settings that every process needs; None if they are missing or wrong."""
    if not _is_installed():
        return None
    from core.settings import StoreSettings

    return _read(StoreSettings)


def of_a_worker() -> "WorkerSettings | None":
    """The same for a worker."""
    if not _is_installed():
        return None
    from core.settings import WorkerSettings

    return _read(WorkerSettings)


def _read(kind: type[AnySettings]) -> AnySettings | None:
    from core.configuration import read

    try:
        return read(kind)
    except Misconfigured:
        return None


def _problems() -> list[str]:
    """A sentence for each way in which a process would refuse to start."""
    from core.configuration import PROCESSES, read
    from core.settings import StoreSettings, WorkerSettings
    from core.variables import variable

    is_workers = bool(os.environ.get(variable("data_dir")))
    kinds = [kind for kind in PROCESSES.values() if is_workers or kind is not WorkerSettings]
    problems: list[str] = []
    for kind in (StoreSettings, *kinds):
        try:
            read(kind)
        except Misconfigured as error:
            if kind is StoreSettings:  # Every process would repeat these.
                return [error.detail]
            problems.append(error.detail)
    return list(dict.fromkeys(problems))


def _is_installed() -> bool:
    return importlib.util.find_spec("pydantic_settings") is not None


def _is_configured() -> bool:
    """Whether anything at all is set."""
    from core.configuration import SECRETS_DIR, names

    return any(os.environ.get(name) for name in names() | {SECRETS_DIR})
