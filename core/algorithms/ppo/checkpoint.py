"""PPO's checkpoints."""

from collections.abc import Mapping
from typing import Any

from core.algorithms.checkpoint import Format, describe

__all__ = ["describe", "pack", "read", "unpack"]

_FORMAT = Format("gaitway-ppo-2")
read, unpack = _FORMAT.read, _FORMAT.unpack


def pack(description: Mapping[str, Any], progress: Mapping[str, int], state: Any) -> bytes:
    """The checkpoint of a state. A bound that is not set is left out: some are older than the bound."""
    told = {name: value for name, value in description.items() if value is not None}
    return _FORMAT.pack(told, progress, state)
