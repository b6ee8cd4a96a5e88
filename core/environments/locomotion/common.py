"""What the pages of Brax's bodies have in common; no numerical code."""

from typing import Literal, Protocol

from core.environments.terms.rewards import Alive, Healthy
from core.environments.terms.task import Reset
from core.environments.terms.terminations import AnyTermination


class HealthyOptions(Protocol):
    """The options of a body that may fall."""

    healthy_reward: float
    terminate_when_unhealthy: bool


def survival(
    options: HealthyOptions, name: str, ends: list[AnyTermination]
) -> tuple[Alive | Healthy, list[AnyTermination]]:
    """The reward for being healthy, and what ends an episode. ends: what is unhealthy.

    If that ends the episode, the step that ends it still earns the reward (as in Brax); otherwise an
    unhealthy step earns none.
    """
    if options.terminate_when_unhealthy:
        return Alive(weight=options.healthy_reward, name=name), ends
    return Healthy(weight=options.healthy_reward, name=name, unless=ends), []


def noisy(scale: float, velocities: Literal["uniform", "normal"] = "uniform") -> Reset:
    """A start with this noise on positions and velocities."""
    return Reset(position_noise=scale, velocity_noise=scale, velocity_distribution=velocities)
