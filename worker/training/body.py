"""The environment of a task, on the device and the engine that its worker has."""

import os
import platform
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax

from core.algorithms.ppo.spec import resolve
from core.environments import catalog
from core.environments.environment import Environment
from core.environments.info import Device, EnvironmentInfo
from core.environments.randomized import randomize
from core.errors import JobFailed
from core.jobs.spec import JobSpec, RolloutSpec, TrainSpec
from core.physics.choose import choose, engine_builder
from worker.messages import Started, Task
from worker.training.compilations import keep_programs, keep_warp_kernels


@dataclass(frozen=True)
class Body:
    """An environment, and how it came to stand on this engine."""

    info: EnvironmentInfo
    environment: Environment
    device: Device
    device_name: str
    engine: str
    engine_reason: str

    def started(self, **details: Any) -> Started:
        """What the job's record shall say about this attempt."""
        packages = ("jax", "brax", "mujoco", "mujoco-mjx", *(["warp-lang"] if self.engine == "warp" else []))
        versions = {name: version(name) for name in packages}
        return Started(
            device=self.device_name,
            engine=self.engine,
            details={
                "engine_reason": self.engine_reason,
                "host": platform.node(),
                "python": platform.python_version(),
                "versions": versions,
                **details,
            },
        )


def load_body(task: Task) -> Body:
    """Raises JobFailed("no_device") where a GPU was promised and JAX finds none.

    And "bad_model" where the model has not got what the job randomises.
    """
    keep_programs()
    device: Device = "cpu" if task.device == "cpu" else "gpu"
    found = jax.devices()[0]
    if device == "gpu" and found.platform != "gpu":
        raise JobFailed(
            "no_device", f"The worker serves {task.device}, but JAX finds only {found.device_kind}."
        )
    info = catalog.find(task.spec.environment.id)
    num_worlds = _num_worlds(task.spec, info, device)
    choice = choose(task.spec.physics, device, info.id, num_worlds, task.engines_that_cannot)
    if choice.name == "warp":
        keep_warp_kernels()
    options = catalog.parse_options(info, task.spec.environment.options)
    model = Path(task.model).absolute() if task.model else None  # It lies in the spool, where we stand.
    environment = catalog.make(info, options, engine_builder(choice.name), model)
    environment = randomize(environment, task.spec.randomization)
    name = found.device_kind if device == "gpu" else f"cpu × {len(os.sched_getaffinity(0))}"
    return Body(info, environment, device, name, choice.name, choice.reason)


def _num_worlds(spec: JobSpec, info: EnvironmentInfo, device: Device) -> int:
    """How many worlds the job steps side by side for most of its time."""
    match spec:
        case TrainSpec():
            return resolve(spec.algorithm, info, device).num_envs
        case RolloutSpec():
            return spec.num_episodes
