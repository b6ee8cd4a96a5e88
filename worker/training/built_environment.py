"""The environment of a task, on the device and the engine that its worker has.

The process finds what was compiled before, and leaves what it compiles.
"""

import os
import platform
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax

from core.devices import gpu_indices
from core.environments import catalog
from core.environments.environment import Environment, innermost
from core.environments.info import Device, EnvironmentInfo
from core.environments.task import TaskEnv
from core.environments.terms.page import task_of, with_task
from core.environments.terms.task import TaskOptions, task_slices
from core.environments.wrappers.domain_randomization import randomize
from core.errors import JobFailed
from core.jobs.resolved import ResolvedJob, resolve_job
from core.jobs.spec import RolloutSpec
from core.physics.availability import CHOOSE_ANOTHER, EngineChoice, EngineName, choose, share_states
from core.physics.choose import engine_builder, set_warp_cache
from core.reasons import Reason
from mujoco_compiled import keep_code
from worker.compile_cache.local import CACHE
from worker.protocol import Started, Task
from worker.training import hosts

# The packages that an engine needs besides MuJoCo and MJX, by the names of the package index.
_ENGINES_PACKAGES = {"warp": ("warp-lang",), "compiled": ("llvmlite",)}


def keep_programs() -> None:
    """Cache JAX's programs, if the supervisor has made a folder for them.

    The path is relative to the spool, the working directory: JAX may make the folder's name part of a
    program's key (0.10 does), and would not find what was compiled under another name.
    """
    if Path(CACHE).is_dir():
        jax.config.update("jax_compilation_cache_dir", f"{CACHE}/jax")
        # JAX keeps what took 1 s to compile. A job waits for dozens of small programs, too.
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


def keep_warp_kernels() -> None:
    """Cache Warp's kernels, too. Raises JobFailed without Warp."""
    if Path(CACHE).is_dir():
        set_warp_cache(Path(CACHE, "warp").absolute())


def keep_machine_code() -> None:
    """Cache the code that the engine `compiled` makes, too."""
    if Path(CACHE).is_dir():
        keep_code(Path(CACHE, "compiled").absolute())


@dataclass(frozen=True)
class BuiltEnvironment:
    """An environment, its engine and the reason for that.

    job: resolved; of a user's own model it has the names of an observation's and an action's numbers alone.
    num_devices: how many share a training. commit: of the code. model: the file of a user's own. clips: the
    files of a reference, by their ids. decoder: that of the policy whose decoder acts.
    """

    job: ResolvedJob
    environment: Environment
    device: Device
    device_name: str
    engine: str
    engine_reason: str
    num_devices: int = 1
    commit: str | None = None
    model: Path | None = None
    clips: Mapping[str, Path] | None = None
    decoder: Path | None = None

    @property
    def info(self) -> EnvironmentInfo:
        return self.job.info

    @property
    def versions(self) -> dict[str, str]:
        """Of the packages that the numbers depend on."""
        also = [*_ENGINES_PACKAGES.get(self.engine, ()), *_brought_by(self.info)]
        names = ("gaitway", "jax", "brax", "mujoco", "mujoco-mjx", *also)
        environment = self.job.spec.environment
        plugins = catalog.plugin_versions(environment.id, environment.options)
        return {**{name: version(name) for name in names}, **plugins}

    def other_versions(self, made_with: Mapping[str, str]) -> str | None:
        """A sentence where the checkpoint was made with other versions than those here.

        made_with: `versions` of the attempt that made it.
        """
        here = self.versions
        differing = [name for name, had in made_with.items() if here.get(name, had) != had]
        if not differing:
            return None
        had = ", ".join(f"{name} {made_with[name]}" for name in differing)
        has = ", ".join(f"{name} {here[name]}" for name in differing)
        return f"The checkpoint was made with {had}; this worker has {has}. The run may go on differently."

    @property
    def task(self) -> TaskOptions | None:
        """The task of terms that the body does; None of a body whose task is not made of terms."""
        return task_of(self.info, self.job.options)

    def doing(self, task: TaskOptions, engine: EngineName) -> Environment:
        """The body with another task of terms, on another engine. Raises JobFailed."""
        info, options = with_task(self.info, self.job.options, task)
        return catalog.make(info, options, engine_builder(engine), self.model, self.clips, self.decoder)

    def started(self, **details: Any) -> Started:
        """The facts on this attempt for the job's record."""
        return Started(
            device=self.device_name,
            engine=self.engine,
            details={
                "engine_reason": self.engine_reason,
                "host": platform.node(),
                "python": platform.python_version(),
                "commit": self.commit,
                "versions": self.versions,
                **details,
            },
        )


def build_environment(task: Task) -> BuiltEnvironment:
    """Build it. Raises JobFailed("device_failed") if JAX finds fewer GPUs than the worker serves.

    Raises JobFailed("bad_model") if the model lacks what the job randomises.
    """
    keep_programs()
    if task.gang is not None:
        hosts.join(task.gang)
    device: Device = "cpu" if task.device == "cpu" else "gpu"
    found = [one for one in jax.devices() if one.process_index == jax.process_index()]
    num_here = len(gpu_indices(task.device)) or 1
    num_hosts = jax.process_count()
    num_devices = num_here * num_hosts
    if device == "gpu" and (found[0].platform != "gpu" or len(found) < num_here):
        raise JobFailed(
            Reason.DEVICE_FAILED, f"The worker serves {task.device}, but JAX finds only {_named(found)}."
        )
    job = resolve_job(task.spec)
    info = replace(job.info, cannot_run=task.engines_that_cannot) if task.model else job.info
    num_envs = _num_envs(job, device) // num_devices
    choice = _choice(task, info, device, num_envs)
    try:
        environment = _made(task, job, choice.name)
    except JobFailed as failed:
        if not _may_take_another(task, choice, failed):
            raise
        info = replace(info, cannot_run={**info.cannot_run, choice.name: failed.detail})
        why = failed.detail.removesuffix(CHOOSE_ANOTHER).strip()
        choice = replace(_choice(task, info, device, num_envs), reason=why)
        environment = _made(task, job, choice.name)
    name = _named(found[:num_here]) if device == "gpu" else f"cpu × {len(os.sched_getaffinity(0))}"
    if num_hosts > 1:
        hosts.check_equal(choice.name)
        name = f"{name}, and the same on {num_hosts - 1} other host{'s' * (num_hosts > 2)}"
    engine, reason = choice.name, choice.reason
    if info.own_physics:
        engine, reason = info.own_physics, f"{info.id} brings its own physics."
    return BuiltEnvironment(
        _with_names(job, environment),
        environment,
        device,
        name,
        engine,
        reason,
        num_devices,
        task.commit,
        _model_of(task),
        _clips_of(task),
        _decoder_of(task),
    )


def _with_names(job: ResolvedJob, environment: Environment) -> ResolvedJob:
    """The job with the names of a user's own model, which only the environment knows here."""
    inner = innermost(environment)
    if not job.info.takes_model or not isinstance(inner, TaskEnv) or not isinstance(job.options, TaskOptions):
        return job
    spaces = task_slices(job.options, inner.inventory)
    sizes = {"observation_size": spaces.observation_size, "action_size": spaces.action_size}
    return ResolvedJob(job.spec, replace(job.info, slices=lambda _: spaces, **sizes), job.options)


def _choice(task: Task, info: EnvironmentInfo, device: Device, num_envs: int) -> EngineChoice:
    rules = info.rules_on(device)
    choice = choose(task.spec.physics, device, num_envs, rules, info.cannot_run, task.body)
    return _that_can_go_on(choice, task) if task.spec.physics == "auto" else choice


def _made(task: Task, job: ResolvedJob, engine: EngineName) -> Environment:
    """The environment on an engine. Raises JobFailed."""
    if engine == "warp":
        keep_warp_kernels()
    if engine == "compiled":
        keep_machine_code()
    model = _model_of(task)
    builder = engine_builder(engine)
    environment = catalog.make(job.info, job.options, builder, model, _clips_of(task), _decoder_of(task))
    environment = randomize(environment, task.spec.randomization)
    if model is not None:
        # Only a reset shows whether the engine has what the job randomises.
        jax.eval_shape(environment.reset, jax.random.key(0))
    return environment


def _model_of(task: Task) -> Path | None:
    """The file of the user's own model; it is in the spool, our working directory."""
    return Path(task.model).absolute() if task.model else None


def _clips_of(task: Task) -> Mapping[str, Path]:
    """The files of the job's reference, by their ids; they are in the spool, too."""
    return {file_id: Path(path).absolute() for file_id, path in task.clips.items()}


def _decoder_of(task: Task) -> Path | None:
    return Path(task.decoder).absolute() if task.decoder else None


def _may_take_another(task: Task, choice: EngineChoice, failed: JobFailed) -> bool:
    """Whether `auto` took `compiled` for a user's model, and it lacks what the job reads or randomises."""
    is_free = task.spec.physics == "auto" and task.begun_on is None and task.model is not None
    return is_free and choice.name == "compiled" and failed.reason == Reason.BAD_MODEL


def _that_can_go_on(choice: EngineChoice, task: Task) -> EngineChoice:
    """The choice, or the engine that made the checkpoint where the run needs that one."""
    if task.begun_on is not None:
        return EngineChoice(task.begun_on, "The job's checkpoint was made on it.")
    if task.source_engine is not None and not share_states(choice.name, task.source_engine):
        return EngineChoice(task.source_engine, "The checkpoint that the job resumes from was made on it.")
    return choice


def _brought_by(info: EnvironmentInfo) -> list[str]:
    return ["playground"] if info.family == "playground" else []


def _named(devices: Sequence[Any]) -> str:
    """The names of the devices, such as `2 × NVIDIA H200`."""
    kinds = Counter(device.device_kind for device in devices)
    return ", ".join(kind if number == 1 else f"{number} × {kind}" for kind, number in kinds.items())


def _num_envs(job: ResolvedJob, device: Device) -> int:
    """The number of environments that the job steps in parallel for most of its time."""
    if isinstance(job.spec, RolloutSpec):
        return job.spec.num_episodes
    return job.settings_on(device).num_parallel_envs
