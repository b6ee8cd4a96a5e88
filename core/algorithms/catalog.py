"""The algorithms that a job may name. To add one, write its package and add it to the union and the rows."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Annotated, Any, TypeVar, get_args

from pydantic import Field, ValidationError, ValidatorFunctionWrapHandler, WrapValidator

from core.algorithms.distillation import spec as distillation
from core.algorithms.dqn import spec as dqn
from core.algorithms.dqn import tuned as dqn_tuned
from core.algorithms.memory import MemoryNeed
from core.algorithms.ppo import spec as ppo
from core.algorithms.ppo import tuned as ppo_tuned
from core.algorithms.q_learning import checks as q_learning
from core.algorithms.q_learning import tuned as q_learning_tuned
from core.algorithms.q_learning.spec import QLearningSpec
from core.algorithms.sac import spec as sac
from core.algorithms.sac import tuned as sac_tuned
from core.algorithms.spec import BaseSpec, check_critic
from core.environments.info import Device, EnvironmentInfo
from core.errors import Problem, Rejected

DEFAULT_ALGORITHM = "ppo"  # A job that names no algorithm gets this one.


def _default_unless_it_says(value: Any, parse: ValidatorFunctionWrapHandler) -> Any:
    if not isinstance(value, Mapping) or "kind" in value:
        return parse(value)
    spec = parse({**value, "kind": DEFAULT_ALGORITHM})
    spec.model_fields_set.discard("kind")  # A field that a client leaves out stays out (decision 2).
    return spec


AlgorithmSpec = Annotated[
    ppo.PPOSpec | dqn.DQNSpec | QLearningSpec | sac.SACSpec | distillation.DistillationSpec,
    Field(discriminator="kind"),
    WrapValidator(_default_unless_it_says),
]


@dataclass(frozen=True)
class AlgorithmInfo:
    """One row: what is known of an algorithm without loading it.

    algorithm: `module:name`, called as `algorithm(environment, settings, seed=, devices=)`; it returns a
    `core.algorithms.algorithm.Algorithm`. policy: `module:name`, called as `policy(content, is_checkpoint=,
    deterministic=)`; it returns a `core.algorithms.trained_policy.TrainedPolicy` from one of its checkpoints
    or policy files.
    tuned: the values that fit an environment on a device, all others unset; a field `episode_length` gets the
    environment's without it. refusal: why resolved values do not go together, or not with an environment;
    None where they do. least_memory: what a run under resolved values certainly needs on each of its devices.
    environment_options: options of the environment of this id that the tuned values are made for.
    layers: the layers of a policy whose activations a rollout can record, with their sizes, under resolved
    values and the size of an action.
    no_export: why its policies are not written for programs elsewhere; None where they are, which needs the
    file of `core.algorithms.policy_file`. A row may leave these six out.
    """

    spec: type[BaseSpec]
    algorithm: str
    policy: str
    tuned: Callable[[EnvironmentInfo, Device], BaseSpec] | None = None
    refusal: Callable[[Any, EnvironmentInfo, Device], Rejected | None] = lambda *_: None
    least_memory: Callable[[Any, EnvironmentInfo, int], MemoryNeed] = lambda *_: MemoryNeed([])
    environment_options: Callable[[Any, str], Mapping[str, Any]] = lambda *_: {}
    no_export: str | None = "this version writes them in one form alone"
    layers: Callable[[Any, int], Mapping[str, int]] = lambda *_: {}


ALGORITHMS: dict[str, AlgorithmInfo] = {
    row.spec.algorithm(): row
    for row in (
        AlgorithmInfo(
            ppo.PPOSpec,
            "core.algorithms.ppo.learner:PPO",
            "core.algorithms.ppo.policy:load",
            ppo_tuned.tuned,
            ppo.refusal,
            ppo.least_memory,
            layers=ppo.layers,
            no_export=None,
        ),
        AlgorithmInfo(
            dqn.DQNSpec,
            "core.algorithms.dqn.learner:DQN",
            "core.algorithms.dqn.policy:load",
            dqn_tuned.tuned,
            dqn.refusal,
            dqn.least_memory,
            dqn_tuned.environment_options,
            "its network values the choices of an action set, and only the environment turns these into "
            "actions. `client.load_policy` gives the choices",
        ),
        AlgorithmInfo(
            QLearningSpec,
            "core.algorithms.q_learning.learner:QLearning",
            "core.algorithms.q_learning.table:load",
            q_learning_tuned.tuned,
            q_learning.refusal,
            q_learning.least_memory,
            q_learning_tuned.environment_options,
            "it is a table and no network. The artifact `tables.npz` of an ended job is that table",
        ),
        AlgorithmInfo(
            sac.SACSpec,
            "core.algorithms.sac.learner:SAC",
            "core.algorithms.sac.policy:load",
            sac_tuned.tuned,
            sac.refusal,
            sac.least_memory,
            layers=sac.layers,
            no_export=None,
        ),
        AlgorithmInfo(
            distillation.DistillationSpec,
            "core.algorithms.distillation.learner:Distillation",
            "core.algorithms.distillation.learner:load",
            refusal=distillation.refusal,
            least_memory=distillation.least_memory,
            layers=distillation.layers,
            no_export=None,
        ),
    )
}


AnySpec = TypeVar("AnySpec", bound=BaseSpec)


def tuned(algorithm: str, environment: EnvironmentInfo, device: Device) -> dict[str, Any]:
    """The hyperparameters that are tuned for the environment, under its options, on this device."""
    row = ALGORITHMS[algorithm]
    has_length = "episode_length" in row.spec.model_fields
    options = {"episode_length": environment.episode_length} if has_length else {}
    ours = row.tuned(environment, device).model_dump(exclude_unset=True) if row.tuned else {}
    of_the_package = (environment.tuned or {}).get(algorithm, {}).get(device, {})
    return {**options, **ours, **of_the_package}


def wrong_tuned(environment: EnvironmentInfo) -> str | None:
    """A sentence on the first of the values that a package has tuned for its body which no job could take;
    None where all are well."""
    for algorithm, by_device in (environment.tuned or {}).items():
        for device, values in by_device.items():
            place = f"tuned.{algorithm}.{device}"
            if algorithm not in ALGORITHMS or device not in get_args(Device):
                return f"{place}: there are the algorithms {', '.join(ALGORITHMS)}, on cpu and gpu."
            try:
                resolve(ALGORITHMS[algorithm].spec.model_validate(values), environment, device)
            except ValidationError as error:
                first = error.errors()[0]
                return f"{'.'.join(map(str, (place, *first['loc'])))}: {first['msg']}."
            except Rejected as refusal:
                return f"{place}: {refusal.detail}"
    return None


def environment_options(spec: BaseSpec, environment_id: str, options: Mapping[str, Any]) -> Mapping[str, Any]:
    """The environment's options that a job takes because it leaves them out beside this algorithm."""
    wanted = ALGORITHMS[spec.algorithm()].environment_options(spec, environment_id)
    return {name: value for name, value in wanted.items() if name not in options}


def resolve(spec: AnySpec, environment: EnvironmentInfo, device: Device) -> AnySpec:
    """Every hyperparameter of a run on this device: the job's value, else the tuned one, else the default.

    Raises Rejected where the values do not go together.
    """
    values = tuned(spec.algorithm(), environment, device)
    settings = type(spec).model_validate({**values, **spec.model_dump(exclude_unset=True)})
    _check_read(settings, values)
    settings = settings.of_environment(environment)
    refusal = check_critic(settings, environment)
    if refusal := refusal or ALGORITHMS[spec.algorithm()].refusal(settings, environment, device):
        raise refusal
    return settings


def _check_read(settings: BaseSpec, values: Mapping[str, Any]) -> None:
    """Raises Rejected where a job gives a setting that is not read. values: those that are tuned."""
    fields = type(settings).model_fields
    problems = [
        Problem(f"/algorithm/{name}", sentence)
        for name, sentence in settings.unread.items()
        if getattr(settings, name) != values.get(name, fields[name].default)
    ]
    if problems:
        raise Rejected(" ".join(problem.detail for problem in problems), problems)


def reported(hyperparameters: Mapping[str, Any]) -> BaseSpec:
    """The settings of a run from its record, without those that only another version has; those that it does
    not read count as left out."""
    settings = _of_this_version(hyperparameters)
    settings.model_fields_set.difference_update(settings.unread)  # With them, a submission is refused.
    return settings


def _of_this_version(hyperparameters: Mapping[str, Any]) -> BaseSpec:
    spec = ALGORITHMS[hyperparameters["kind"]].spec
    try:
        return spec.model_validate(hyperparameters)
    except ValidationError as error:
        foreign = {one["loc"][0] for one in error.errors() if one["type"] == "extra_forbidden"}
    return spec.model_validate({name: hyperparameters[name] for name in {*hyperparameters} - foreign})


def least_memory(settings: BaseSpec, environment: EnvironmentInfo, num_devices: int) -> MemoryNeed:
    """The memory that a run under these resolved values certainly needs on each of its devices."""
    return ALGORITHMS[settings.algorithm()].least_memory(settings, environment, num_devices)


def loaded(name: str) -> Callable[..., Any]:
    """The object at a row's `module:name`. This call loads its code, and with it the numerical stack."""
    module, _, function = name.partition(":")
    return getattr(import_module(module), function)
