"""The requests to a service, each as a call that `Client` and `AsyncClient` carry out (`gaitway.steps`).

Their methods have the names of these, and their descriptions stand in `Client`.
"""

from gaitway.calls.files import FileCalls
from gaitway.calls.following import FollowingCalls
from gaitway.calls.importing import ImportCalls
from gaitway.calls.jobs import JobCalls
from gaitway.calls.previews import PreviewCalls
from gaitway.calls.service import ServiceCalls
from gaitway.calls.sweeps import SweepCalls


class Calls(JobCalls, SweepCalls, FollowingCalls, FileCalls, ImportCalls, PreviewCalls, ServiceCalls):
    """Calls of one service."""
