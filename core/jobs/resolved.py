"""A job's specification and what the catalogs make of it: resolved once, for checks, views and workers."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import cast

from core.algorithms import catalog as algorithms
from core.algorithms.memory import Memory
from core.algorithms.spec import BaseSpec
from core.documents import Strict
from core.environments import catalog
from core.environments.info import Device, EnvironmentInfo
from core.environments.mjcf.info import MjcfOptions
from core.environments.mjcf.slices import mjcf_slices
from core.errors import EnvironmentNotFound, Problem, Rejected
from core.jobs.own_model import engines_that_cannot, own_model
from core.jobs.spec import Accelerator, EnvironmentSpec, JobSpec, TrainSpec
from core.user_models.record import Description
from core.user_models.store import ModelStore

DEVICES: dict[Accelerator, tuple[Device, ...]] = {"any": ("cpu", "gpu"), "cpu": ("cpu",), "gpu": ("gpu",)}


@dataclass(frozen=True)
class ResolvedJob:
    """A specification with its environment's row of the catalog, and with the hyperparameters by device.

    info: the row under the job's options; its `cannot_run` names the engines that cannot run the job, and
    why. options: those of the environment, with defaults filled in.
    """

    spec: JobSpec
    info: EnvironmentInfo
    options: Strict
    _settings: dict[Device, BaseSpec] = field(default_factory=dict[Device, BaseSpec], init=False, repr=False)

    @property
    def settings(self) -> Mapping[Device, BaseSpec]:
        """`settings_on` each kind of device that the job may get; empty for a rollout. Raises Rejected."""
        is_training = isinstance(self.spec, TrainSpec)
        return {
            device: self.settings_on(device) for device in DEVICES[self.spec.resources.kind] if is_training
        }

    def settings_on(self, device: Device) -> BaseSpec:
        """Every hyperparameter of a training on this kind of device. Raises Rejected."""
        if device not in self._settings:
            spec = cast("TrainSpec", self.spec)
            self._settings[device] = algorithms.resolve(spec.algorithm, self.info, device)
        return self._settings[device]

    @property
    def memory(self) -> Mapping[Device, Memory]:
        """`memory_on` each kind of device that the job may get; empty for a rollout. Raises Rejected."""
        return {device: self.memory_on(device, self.spec.resources.gpus) for device in self.settings}

    def memory_on(self, device: Device, num_devices: int) -> Memory:
        """The least memory that a training, with all its seeds, needs on each of its devices."""
        spec = cast("TrainSpec", self.spec)
        one = algorithms.least_memory(self.settings_on(device), self.info, num_devices)
        return one.of_seeds(len(spec.seeds or [spec.seed]))


def resolve_job(spec: JobSpec, models: ModelStore | None = None) -> ResolvedJob:
    """The job under `resolve_environment`. Raises Rejected."""
    return ResolvedJob(spec, *resolve_environment(spec.environment, models))


def resolve_environment(
    environment: EnvironmentSpec, models: ModelStore | None = None
) -> tuple[EnvironmentInfo, Strict]:
    """The environment's row of the catalog under these options, and the options with defaults filled in.

    models: without it, the row of a user's own model lacks what depends on the model. Raises Rejected.
    """
    try:
        info, options = catalog.resolve(environment.id, environment.options)
    except EnvironmentNotFound as error:
        raise Rejected(error.detail, [Problem("/environment", error.detail)]) from None
    if models is not None and isinstance(options, MjcfOptions):
        info = _row_of(info, options, own_model(options, models))
    return info, options


def _row_of(info: EnvironmentInfo, options: MjcfOptions, description: Description) -> EnvironmentInfo:
    """The catalog's row, with the values that depend on the model."""
    has = description.inventory
    spaces = mjcf_slices(options, has)
    return replace(
        info,
        observation_size=spaces.observation_size,
        action_size=has.sizes.nu,
        slices=partial(mjcf_slices, model=has),
        cameras=tuple(has.cameras),
        cannot_run=engines_that_cannot(description, options),
    )
