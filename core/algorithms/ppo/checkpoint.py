"""PPO's checkpoints."""

from collections.abc import Mapping
from typing import Any

from core.algorithms.checkpoint import Format

FORMAT = Format("gaitway-ppo-2")


def header(description: Mapping[str, Any]) -> dict[str, Any]:
    """A checkpoint's header. An unset bound is left out: some checkpoints are older than the bound."""
    return {name: value for name, value in description.items() if value is not None}
