"""PPO's checkpoints."""

from core.algorithms.checkpoint import Format, describe

__all__ = ["describe", "pack", "read", "unpack"]

_FORMAT = Format("gaitway-ppo-2")
pack, read, unpack = _FORMAT.pack, _FORMAT.read, _FORMAT.unpack
