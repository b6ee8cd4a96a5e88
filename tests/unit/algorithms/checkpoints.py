"""Checkpoints of PPO that no run has made."""

from collections.abc import Mapping
from typing import Any

from core.algorithms.ppo.learner import FORMAT, header


def pack(description: Mapping[str, Any], progress: Mapping[str, int], state: Any) -> bytes:
    return FORMAT.pack(header(description), progress, state)
