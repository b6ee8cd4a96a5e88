"""PPO's checkpoints."""

from typing import Any

from core.algorithms import checkpoint
from core.algorithms.checkpoint import Format
from core.algorithms.ppo.spec import PPOSpec
from core.environments.environment import Environment

__all__ = ["describe", "pack", "read", "unpack"]

_FORMAT = Format("gaitway-ppo-2")
pack, read, unpack = _FORMAT.pack, _FORMAT.read, _FORMAT.unpack


def describe(environment: Environment, settings: PPOSpec) -> dict[str, Any]:
    """What a checkpoint and the run that resumes from it must have in common.

    A bound that is not set is left out: checkpoints were written before there was one.
    """
    common = checkpoint.describe(environment, settings)
    return {name: value for name, value in common.items() if value is not None}
