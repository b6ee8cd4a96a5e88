"""What a trained body reaches, for the gate benches. Set before any tuning, and never moved since.

On a GPU: what Brax's own trainer reached at the end of its budget, the mean of three seeds, in the benches of
2026-11-21. On a CPU: a speed at which the ant plainly runs.
"""

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class Mark:
    """At least `least` of `metric`, one of an evaluation's, as the mean over its episodes. unit: of it."""

    metric: str
    least: float
    unit: str

    def in_request(self) -> dict[str, Any]:
        return asdict(self)


_RETURN, _SPEED = "eval/episode_reward", "eval/forward_speed"
ON_A_GPU = {
    "ant": Mark(_RETURN, 3459.0, ""),
    "humanoid": Mark(_RETURN, 7130.0, ""),
    "half_cheetah": Mark(_RETURN, 4771.0, ""),
    "walker2d": Mark(_RETURN, 4515.0, ""),
    "hopper": Mark(_RETURN, 762.0, ""),
}
ON_A_CPU = {"ant": Mark(_SPEED, 1.4, "m/s")}
# Episodes of an evaluation.
NUM_EPISODES = 128
