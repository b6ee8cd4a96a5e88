"""An epoch's metrics, as every off-policy algorithm tells them."""

from collections.abc import Mapping
from typing import Any


def training_metrics(sums: Mapping[str, Any], num_updates: int, action_repeat: int) -> dict[str, float]:
    """By Brax's names, of sums over `num_updates` updates; lengths are in environment steps."""
    values = {name: float(value) for name, value in sums.items()}
    episodes, score, length, falls = (values.pop(name) for name in ("episodes", "score", "length", "falls"))
    metrics = {f"training/{name}": value / num_updates for name, value in values.items()}
    if episodes:
        metrics["training/episode_reward"] = score / episodes
        metrics["training/episode_length"] = length / episodes * action_repeat
        metrics["training/fall_rate"] = falls / episodes
    return metrics
