"""The parts of an off-policy run's memory that every algorithm has."""

from core.algorithms.memory import FLOAT_BYTES, Part
from core.algorithms.off_policy.spec import OffPolicySpec
from core.environments.info import EnvironmentInfo

# Reward, and how the step ended.
_SCALARS = 3


def replay_bytes(settings: OffPolicySpec, environment: EnvironmentInfo, numbers_per_action: int) -> int:
    """The size of the replay, on the device and in a checkpoint. Unknown sizes count as 0.

    numbers_per_action: how many a row keeps of one environment's action.
    """
    observation = environment.observation_size or 0
    numbers = observation + numbers_per_action + _SCALARS
    return FLOAT_BYTES * settings.replay_rows * settings.num_envs * numbers


def replay_part(settings: OffPolicySpec, environment: EnvironmentInfo, numbers_per_action: int) -> Part:
    """The replay's part of a run's memory."""
    kept = settings.replay_rows * settings.num_envs
    size = replay_bytes(settings, environment, numbers_per_action)
    return Part(f"the {kept:,} transitions that are kept", size, ("max_replay_size",))


def environments_part(settings: OffPolicySpec, environment: EnvironmentInfo) -> Part:
    """What is certainly kept of each environment: its observation and its reward."""
    size = FLOAT_BYTES * settings.num_envs * ((environment.observation_size or 0) + 1)
    return Part(f"{settings.num_envs:,} environments", size, ("num_envs",))
