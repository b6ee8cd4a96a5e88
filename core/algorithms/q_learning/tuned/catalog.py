"""Which environments Q-learning has tuned values for. To add some, write a module here and add its line."""

from collections.abc import Callable, Mapping
from typing import Any

from core.algorithms.q_learning.options import steers_a_generator
from core.algorithms.q_learning.spec import QLearningSpec
from core.algorithms.q_learning.tuned.brittle_star import brittle_star
from core.environments.info import Device, EnvironmentInfo

# By environment, as its options say.
TUNED_BY_OPTIONS: dict[str, Callable[[Any], Mapping[Device, QLearningSpec]]] = {
    "brittle_star": brittle_star,
    "brittle_star_light_escape": brittle_star,
    "brittle_star_undirected": brittle_star,
}


def tuned(environment: EnvironmentInfo, device: Device) -> QLearningSpec:
    """The values that fit the environment on this device; all others are unset."""
    by_options = TUNED_BY_OPTIONS.get(environment.id)
    values = by_options(environment.option_values) if by_options else {}
    return values.get(device, QLearningSpec())


def environment_options(settings: QLearningSpec, environment_id: str) -> Mapping[str, Any]:
    """Options of the environment that its tuned values, or the job's action set, are made for."""
    steers = steers_a_generator(settings.action_set)
    return {"control": "cpg"} if environment_id in TUNED_BY_OPTIONS and steers else {}
