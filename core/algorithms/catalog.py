"""The algorithms a job may name. To add one, write its package and add a member of the union and a row."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Annotated, Any, TypeVar

from pydantic import Field, ValidatorFunctionWrapHandler, WrapValidator

from core.algorithms.ppo.spec import PPOSpec
from core.algorithms.ppo.tuned.catalog import tuned as tuned_ppo
from core.algorithms.q_learning.spec import QLearningSpec
from core.algorithms.q_learning.tuned.catalog import tuned as tuned_q_learning
from core.algorithms.spec import BaseSpec
from core.environments.info import Device, EnvironmentInfo


def _ppo_unless_it_says(value: Any, parse: ValidatorFunctionWrapHandler) -> Any:
    if not isinstance(value, Mapping) or "kind" in value:
        return parse(value)
    spec = parse({**value, "kind": "ppo"})
    spec.model_fields_set.discard("kind")  # What a client leaves out stays out (decision 2).
    return spec


AlgorithmSpec = Annotated[
    PPOSpec | QLearningSpec, Field(discriminator="kind"), WrapValidator(_ppo_unless_it_says)
]


@dataclass(frozen=True)
class AlgorithmInfo:
    """One row: what is known of an algorithm without loading it.

    algorithm: `module:name`, called as `algorithm(environment, settings, seed=, devices=)`; it returns a
    `core.algorithms.algorithm.Algorithm`. policy: `module:name`, called as `policy(content, is_checkpoint=,
    deterministic=)`; it returns a `core.algorithms.policy.TrainedPolicy` from one of its checkpoints or
    policy files. tuned: the values that fit an environment on a device, all others unset; None if there are
    none.
    """

    spec: type[BaseSpec]
    algorithm: str
    policy: str
    tuned: Callable[[EnvironmentInfo, Device], BaseSpec] | None = None


ALGORITHMS: dict[str, AlgorithmInfo] = {
    row.spec.algorithm(): row
    for row in (
        AlgorithmInfo(
            PPOSpec, "core.algorithms.ppo.algorithm:PPO", "core.algorithms.ppo.policy:load", tuned_ppo
        ),
        AlgorithmInfo(
            QLearningSpec,
            "core.algorithms.q_learning.algorithm:QLearning",
            "core.algorithms.q_learning.policy:load",
            tuned_q_learning,
        ),
    )
}


AnySpec = TypeVar("AnySpec", bound=BaseSpec)


def tuned(algorithm: str, environment: EnvironmentInfo, device: Device) -> dict[str, Any]:
    """The hyperparameters that are tuned for the environment, under its options, on this device."""
    row = ALGORITHMS.get(algorithm)
    if row is None or row.tuned is None:
        return {}
    return row.tuned(environment, device).model_dump(exclude_unset=True)


def resolve(spec: AnySpec, environment: EnvironmentInfo, device: Device) -> AnySpec:
    """Every hyperparameter of a run on this device: the job's value, else the tuned one, else the default.

    Raises Rejected where the values do not go together.
    """
    values = tuned(spec.algorithm(), environment, device)
    settings = type(spec).model_validate({**values, **spec.model_dump(exclude_unset=True)})
    if refusal := settings.refusal(environment, device):
        raise refusal
    return settings


def loaded(name: str) -> Callable[..., Any]:
    """The object at a row's `module:name`. This call loads its code, and with it the numerical stack."""
    module, _, function = name.partition(":")
    return getattr(import_module(module), function)
