"""The documents of the service: the API writes them, the client reads them.

The service writes every member. A client reads without those that have a default here, and ignores members
that it does not know, so that it works with an older and with a newer service.
"""

from gaitway.schema.accounts import (
    AuditView,
    NewTokenView,
    ProjectView,
    ProviderView,
    SessionView,
    TokenView,
    UserView,
    WhoView,
    WorkerSettingsView,
)
from gaitway.schema.base import FINAL_STATUSES, View
from gaitway.schema.catalog import (
    DeviceUsageView,
    EnvironmentDetails,
    EnvironmentView,
    ModelView,
    PreviewView,
    ProjectUsageView,
    SliceView,
    SlotsView,
    SlotView,
    StillView,
    UsageView,
    WorkerView,
)
from gaitway.schema.jobs import (
    ArtifactView,
    AttemptView,
    JobView,
    Metrics,
    MetricsRow,
    OriginView,
    OutcomeView,
    ProgressView,
    RemovedView,
    TurnView,
)
from gaitway.schema.news import DeliveryView, NewWebhookView, WebhookView
from gaitway.schema.retention import (
    NeededView,
    RemovalView,
    RemovedRoleView,
    RetentionPreviewView,
    RetentionView,
)
from gaitway.schema.sweeps import GroupView, SweepDetails, SweepView, TrialView

__all__ = [
    "FINAL_STATUSES",
    "ArtifactView",
    "AttemptView",
    "AuditView",
    "DeliveryView",
    "DeviceUsageView",
    "EnvironmentDetails",
    "EnvironmentView",
    "GroupView",
    "JobView",
    "Metrics",
    "MetricsRow",
    "ModelView",
    "NeededView",
    "NewTokenView",
    "NewWebhookView",
    "OriginView",
    "OutcomeView",
    "PreviewView",
    "ProgressView",
    "ProjectUsageView",
    "ProjectView",
    "ProviderView",
    "RemovalView",
    "RemovedRoleView",
    "RemovedView",
    "RetentionPreviewView",
    "RetentionView",
    "SessionView",
    "SliceView",
    "SlotView",
    "SlotsView",
    "StillView",
    "SweepDetails",
    "SweepView",
    "TokenView",
    "TrialView",
    "TurnView",
    "UsageView",
    "UserView",
    "View",
    "WebhookView",
    "WhoView",
    "WorkerSettingsView",
    "WorkerView",
]
