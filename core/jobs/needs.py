"""The needs of a job besides a device: optional packages of the worker, and memory."""

from collections.abc import Mapping
from importlib.util import find_spec

from core.algorithms.memory import Memory
from core.devices import gpu_indices
from core.environments import catalog
from core.environments.info import Device
from core.errors import GaitwayError
from core.jobs.job import Job
from core.jobs.resolved import resolve_job
from core.jobs.spec import JobSpec, TrainSpec
from core.physics.availability import PACKAGES

# The extra of Gaitway that installs an optional package, by the package's import name.
_EXTRAS: dict[str, str] = {
    **{package: engine for engine, package in PACKAGES.items()},
    "dm_control": "dm-control",
    "biorobot": "brittle-star",
    "mujoco_playground": "playground",
}


def packages_here() -> tuple[str, ...]:
    """The optional packages that are installed here; none is imported."""
    rows = catalog.ENVIRONMENTS.values()
    optional = {*PACKAGES.values(), *(info.package for info in rows if info.package is not None)}
    return tuple(package for package in sorted(optional) if find_spec(package) is not None)


def how_to_install(package: str) -> str:
    """The command that installs an optional package, or only its name. package: its import name."""
    extra = _EXTRAS.get(package)
    return f"the Python package {package}" if extra is None else f"uv sync --inexact --extra {extra}"


def packages_for(job: Job) -> Mapping[str, str]:
    """The optional packages that the job needs, each with what needs it."""
    environment, needed = job.spec.environment.id, dict[str, str]()
    info = catalog.ENVIRONMENTS.get(environment)
    if info is not None and info.package is not None:
        needed[info.package] = f"the environment {environment}"
    engine = job.spec.physics
    if engine == "auto" and isinstance(job.spec, TrainSpec) and job.begun is not None:
        engine = job.begun.engine  # Its checkpoint was made with it.
    for name, package in PACKAGES.items():
        if name == engine:
            needed[package] = f"the engine {name}"
    return needed


def memory_for(spec: JobSpec) -> Mapping[Device, Memory]:
    """The least memory that a training needs on each kind of device; empty where that is not known."""
    try:
        return resolve_job(spec).memory
    except GaitwayError:  # A version with other rules accepted it; the attempt says what is wrong.
        return {}


def kind_of(device: str) -> Device:
    """The kind of a worker's device."""
    return "gpu" if gpu_indices(device) else "cpu"
