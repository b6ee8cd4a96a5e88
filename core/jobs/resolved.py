"""A job's specification and what the catalogs make of it: resolved once, for checks, views and workers."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, cast

from pydantic import ValidationError

from core.algorithms import catalog as algorithms
from core.algorithms.memory import MemoryNeed
from core.algorithms.spec import BaseSpec
from core.documents import Strict
from core.environments import catalog
from core.environments.info import Device, EnvironmentInfo
from core.environments.mjcf import edit_check
from core.environments.mjcf.check import problems
from core.environments.mjcf.edit_check import edited
from core.environments.mjcf.edit_options import ModelEdits
from core.environments.mjcf.info import MjcfOptions
from core.environments.terms.inventory import Inventory, inventory_of, names_by_kind, parts_by_kind
from core.environments.terms.task import task_slices
from core.errors import EnvironmentNotFound, ModelNotFound, Problem, Rejected
from core.jobs.job import Job
from core.jobs.spec import Accelerator, EnvironmentSpec, JobSpec, TrainSpec
from core.jobs.uploads import Uploads, check_clips
from core.physics.availability import EngineName, beyond
from core.uploads import library
from core.user_models.record import Description

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
    def memory(self) -> Mapping[Device, MemoryNeed]:
        """`memory_on` each kind of device that the job may get; empty for a rollout. Raises Rejected."""
        return {device: self.memory_on(device, self.spec.resources.num_devices) for device in self.settings}

    def memory_on(self, device: Device, num_devices: int) -> MemoryNeed:
        """The least memory that a training, with all its seeds, needs on each of its devices."""
        spec = cast("TrainSpec", self.spec)
        one = algorithms.least_memory(self.settings_on(device), self.info, num_devices)
        return one.of_seeds(len(spec.seeds or [spec.seed]))


def resolve_job(spec: JobSpec, uploads: Uploads | None = None) -> ResolvedJob:
    """The job under `resolve_environment`. Raises Rejected."""
    return ResolvedJob(spec, *resolve_environment(spec.environment, uploads))


def resolve_environment(
    environment: EnvironmentSpec, uploads: Uploads | None = None
) -> tuple[EnvironmentInfo, Strict]:
    """The environment's row of the catalog under these options, and the options with defaults filled in.

    uploads: without it, the row of a user's own model lacks what depends on the model, and clips are not
    looked at. Raises Rejected.
    """
    try:
        info, options = catalog.resolve(environment.id, environment.options)
    except EnvironmentNotFound as error:
        raise Rejected(error.detail, [Problem("/environment", error.detail)]) from None
    if uploads is None:
        return info, options
    description = own_model(options, uploads) if isinstance(options, MjcfOptions) else None
    if isinstance(options, MjcfOptions) and description is not None:
        info = _row_of(info, options, description)

    def model() -> Inventory:
        return inventory_of(environment.id) if description is None else description.inventory

    check_clips(environment, info, uploads, model)
    return info, options


def _row_of(info: EnvironmentInfo, options: MjcfOptions, description: Description) -> EnvironmentInfo:
    """The catalog's row, with the values that depend on the model."""
    has = edited(description.inventory, options.edits)
    spaces = task_slices(options, has)
    return replace(
        info,
        observation_size=spaces.observation_size,
        action_size=spaces.action_size,
        slices=partial(task_slices, model=has),
        cameras=tuple(has.cameras),
        parts=parts_by_kind(has),
        names=names_by_kind(has),
        cannot_run=engines_that_cannot(description, options),
    )


_POINTER, _EDITS = "/environment/options/model", "/environment/options/edits"


def own_model(options: MjcfOptions, store: Uploads) -> Description:
    """The description of the model that the options name.

    Raises Rejected where the model does not exist, is not validated yet, or does not fit the options.
    """
    try:
        record = library.find(options.model, store.models)
    except ModelNotFound as error:
        raise Rejected(error.detail, [Problem(_POINTER, error.detail)]) from None
    if record.status != "ready" or record.description is None:
        detail = (
            f"The model {options.model} was refused: {record.message}"
            if record.status == "refused"
            else f"The model {options.model} is still being validated; ask GET /models/{options.model}."
        )
        raise Rejected(detail, [Problem(_POINTER, detail)])
    before = record.description.inventory
    found = list(edit_check.problems(options.edits, before, _EDITS))
    if found := found or problems(options, edited(before, options.edits)):
        raise Rejected(" ".join(problem.detail for problem in found[:5]), found)
    return record.description


def model_of(environment: EnvironmentSpec) -> str | None:
    """The id of the user's own model that an environment names; the environment was checked before."""
    if not catalog.find(environment.id).takes_model:
        return None
    return str(environment.options["model"])


def engines_that_cannot(description: Description | None, options: MjcfOptions) -> Mapping[EngineName, str]:
    """Engines that cannot run the model, or read what the options read of it, each with the reason."""
    if description is None:
        return options.cannot_run
    # What was tried is the model as it was sent.
    tried = description.engines.items() if options.edits == ModelEdits() else ()
    cannot = dict(options.cannot_run)
    cannot |= {name: why for name, why in tried if why is not None}
    for sensor in description.inventory.sensors:
        if options.sensors is None or sensor.name in options.sensors:
            for engine, why in sensor.beyond.items():
                cannot.setdefault(engine, beyond(engine, why))
    return cannot


def filled_in(job: Job, store: Uploads) -> dict[str, Any]:
    """The specification as JSON, with every field. It may be submitted again.

    The hyperparameters are those of the newest attempt; before there is one, those that a CPU would get, or
    a GPU where the job asks for one. Of an environment that the service no longer has, or whose model was
    deleted, the options that were not sent are left out.
    """
    spec = job.spec
    document: dict[str, Any] = {"kind": spec.kind, **spec.model_dump(mode="json")}
    if "gpus" not in spec.resources.model_fields_set:
        del document["resources"]["gpus"]  # A job that says 1 gets a GPU.
    resolved = None
    try:
        resolved = resolve_job(spec, store)
        document["environment"]["options"] = resolved.options.model_dump(mode="json")
    except Rejected:
        document["environment"]["options"] = dict(spec.environment.options)
    if isinstance(spec, TrainSpec):
        settings = _hyperparameters(job, spec, resolved)
        unread = _unread(settings)  # With them, it could not be submitted again.
        document["algorithm"] = {name: value for name, value in settings.items() if name not in unread}
        del document["seeds" if spec.seeds is None else "seed"]  # The two exclude each other.
    if spec.video is not None and spec.video.cameras is not None:
        del document["video"]["camera"]  # The two exclude each other.
    return document


def _unread(hyperparameters: Mapping[str, Any]) -> Collection[str]:
    """The names of settings that a run does not read beside the others."""
    try:
        return algorithms.reported(hyperparameters).unread
    except ValidationError:  # Of another version.
        return ()


def _hyperparameters(job: Job, spec: TrainSpec, resolved: ResolvedJob | None) -> dict[str, Any]:
    for attempt in reversed(job.attempts):
        if used := attempt.details.get("hyperparameters"):
            return {"kind": spec.algorithm.algorithm(), **used}
    if resolved is None:
        return {
            "kind": spec.algorithm.algorithm(),
            **spec.algorithm.model_dump(mode="json", exclude_unset=True),
        }
    return resolved.settings_on(DEVICES[spec.resources.kind][0]).model_dump(mode="json")
