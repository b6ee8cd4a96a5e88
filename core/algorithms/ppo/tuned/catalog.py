"""Which environments PPO has tuned values for.

To add some, write {"cpu": ..., "gpu": ...} in a module here, and its line in `_BY_ENVIRONMENT`, or in
`TUNED_BY_OPTIONS` if they depend on options.
"""

from collections.abc import Callable, Mapping
from typing import Any

from core.algorithms.ppo.spec import PPOSpec
from core.algorithms.ppo.tuned.brittle_star import brittle_star
from core.algorithms.ppo.tuned.locomotion import (
    ANT,
    HALF_CHEETAH,
    HOPPER,
    HUMANOID,
    INVERTED_PENDULUM,
    REACHER,
    WALKER2D,
)
from core.algorithms.ppo.tuned.mjcf import MJCF
from core.algorithms.ppo.tuned.playground import PLAYGROUND
from core.algorithms.ppo.tuned.runners import RODENT, corridor
from core.environments.external.brax.info import SAME_TASK
from core.environments.info import Device, EnvironmentInfo

_BY_ENVIRONMENT: dict[str, Mapping[Device, PPOSpec]] = {
    "ant": ANT,
    "half_cheetah": HALF_CHEETAH,
    "hopper": HOPPER,
    "humanoid": HUMANOID,
    "inverted_pendulum": INVERTED_PENDULUM,
    "mjcf": MJCF,
    "reacher": REACHER,
    "rodent": RODENT,
    "walker2d": WALKER2D,
    **PLAYGROUND,
}
# By environment. Brax's registry has no tuned settings; a task that is also ours has ours.
TUNED = {**_BY_ENVIRONMENT, **{theirs: _BY_ENVIRONMENT[ours] for theirs, ours in SAME_TASK.items()}}
# By environment: values that depend on its options.
TUNED_BY_OPTIONS: dict[str, Callable[[Any], Mapping[Device, PPOSpec]]] = {
    "brittle_star": brittle_star,
    "brittle_star_light_escape": brittle_star,
    "brittle_star_undirected": brittle_star,
    "corridor": corridor,
}


def tuned(environment: EnvironmentInfo, device: Device) -> PPOSpec:
    """The values that fit the environment on this device; all others are unset."""
    values = TUNED.get(environment.id, {})
    if by_options := TUNED_BY_OPTIONS.get(environment.id):
        values = by_options(environment.option_values)
    return values.get(device, PPOSpec())
