"""Gaitway: send training jobs to a service, and fetch policies, metrics and videos."""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gaitway.async_client import AsyncClient, AsyncJob
    from gaitway.client import Client, Job
    from gaitway.errors import (
        ApiError,
        Conflict,
        DownloadFailed,
        FieldError,
        Forbidden,
        GaitwayError,
        MissingExtra,
        NotFound,
        NotReady,
        PolicyUnreadable,
        Rejected,
        Unauthenticated,
        Unavailable,
        Unreachable,
        WaitTimeout,
        WrongAddress,
    )
    from gaitway.retry import Retry
    from gaitway.schema import ArtifactView, JobView, MetricsRow, ProgressView, SweepView
    from gaitway.views import Event, Page

__all__ = [
    "ApiError",
    "ArtifactView",
    "AsyncClient",
    "AsyncJob",
    "Client",
    "Conflict",
    "DownloadFailed",
    "Event",
    "FieldError",
    "Forbidden",
    "GaitwayError",
    "Job",
    "JobView",
    "MetricsRow",
    "MissingExtra",
    "NotFound",
    "NotReady",
    "Page",
    "PolicyUnreadable",
    "ProgressView",
    "Rejected",
    "Retry",
    "SweepView",
    "Unauthenticated",
    "Unavailable",
    "Unreachable",
    "WaitTimeout",
    "WrongAddress",
]
_HOMES = (
    "gaitway.errors",
    "gaitway.schema",
    "gaitway.views",
    "gaitway.retry",
    "gaitway.client",
    "gaitway.async_client",
)


def __getattr__(name: str) -> object:
    """A name of `__all__`, imported when it is first used.

    Each process of the embedded stack imports this package but needs no client, which takes 0.3 s to import.
    """
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    homes = map(import_module, _HOMES)  # One after the other: asynchronous programs alone need the last one.
    return next(getattr(home, name) for home in homes if hasattr(home, name))
