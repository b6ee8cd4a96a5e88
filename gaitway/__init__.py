"""Gaitway: send training jobs to a service, and bring back policies, metrics and videos."""

from gaitway.client import Client
from gaitway.errors import (
    ApiError,
    Conflict,
    DownloadFailed,
    FieldError,
    GaitwayError,
    MissingExtra,
    NotFound,
    NotReady,
    Rejected,
    Unavailable,
    Unreachable,
    WaitTimeout,
)
from gaitway.transport import Retry
from gaitway.views import ArtifactView, Event, JobView, MetricsRow, Page, ProgressView

__all__ = [
    "ApiError",
    "ArtifactView",
    "Client",
    "Conflict",
    "DownloadFailed",
    "Event",
    "FieldError",
    "GaitwayError",
    "JobView",
    "MetricsRow",
    "MissingExtra",
    "NotFound",
    "NotReady",
    "Page",
    "ProgressView",
    "Rejected",
    "Retry",
    "Unavailable",
    "Unreachable",
    "WaitTimeout",
]
