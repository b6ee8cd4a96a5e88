"""Which of SAC's hyperparameters go together."""

from core.algorithms.off_policy.checks import rejected, replay_refusal
from core.algorithms.sac.spec import SACSpec
from core.environments.info import Device, EnvironmentInfo
from core.errors import Rejected


def refusal(settings: SACSpec, environment: EnvironmentInfo, device: Device) -> Rejected | None:
    """Why these values do not go together; None where they do."""
    return _empty_range(settings) or replay_refusal(settings, environment, environment.action_size or 0)


def _empty_range(settings: SACSpec) -> Rejected | None:
    if settings.value_min < settings.value_max:
        return None
    return rejected(
        f"value_min = {settings.value_min:g} is not below value_max = {settings.value_max:g}: "
        "the critics need a range of returns.",
        "value_min",
        "value_max",
    )
