"""A training job: the events of a run become messages and files."""

import math
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Protocol

import jax
from numpy.typing import NDArray

from core.algorithms.events import (
    BodyLost,
    CheckpointReady,
    Evaluated,
    Evaluating,
    Event,
    Phase,
    SeedDiverged,
    TrainingProgress,
)
from core.algorithms.memory import MemoryNeed
from core.algorithms.run import Run, make_run
from core.algorithms.seeds import make_seeds_run
from core.algorithms.spec import BaseSpec
from core.algorithms.trained_policy import load_policy
from core.environments.info import Device
from core.errors import JobFailed
from core.jobs.decoders import why_it_lends_to_few
from core.jobs.job import JobPhase
from core.jobs.spec import TrainSpec
from core.reasons import Reason
from worker.host.memory import allowed_bytes
from worker.protocol import Advanced, Measured, MemoryPeak, Noted, PhaseBegan, PhaseEnded, Task
from worker.stopping import StopRequest
from worker.training.battery import BatteryWriter
from worker.training.built_environment import BuiltEnvironment
from worker.training.event_writer import EventWriter
from worker.training.exports import ExportWriter, PolicyInTraining
from worker.training.lost_body import keep_lost_body
from worker.training.pictures import kept_with_tables
from worker.training.policy_files import PolicyFiles
from worker.training.policy_videos import PolicyVideos

# A tenth of the budget lies between checkpoints where the job does not say.
_CHECKPOINTS = 10

# A peak is told of again when it has grown by this factor.
_NEWS_OF_PEAK = 1.01

# Sentences for the job's events. Each is sent the first time that its metric is above 0.
_WARNINGS = {
    "training/physics_overflow": "the engine had no room for all contacts of some environments "
    "(training/physics_overflow is the share of steps). On warp contacts were lost, on compiled the episode "
    "ended. Give more room by the option `nconmax` (compiled), or choose another engine by `physics`.",
    "training/lost_bodies": "an engine lost the state of a body: its values were not finite, and its "
    "episode ended (training/lost_bodies is the share of steps). Stiff contacts, strong actuators or a long "
    "timestep can be the cause.",
}
_NEW_CLIPS = (
    "The checkpoint is of a job with other clips: the policy goes on from there; episodes, and the counts of "
    "where in the clips they fail, begin again."
)


def train(
    task: Task, spec: TrainSpec, built: BuiltEnvironment, events: EventWriter, stopping: StopRequest
) -> bool:
    """Train to the end or to a stop; whether a stop cut it short.

    Keeps checkpoints, the newest one's policy as `policy.npz`, and the best evaluation's as `policy-best`;
    and at the end, unless the job continues elsewhere, its policy, both also for programs elsewhere, and the
    video and the battery that it asks for. Each of several seeds has such policies, a video and a battery of
    its own.
    """
    settings = built.job.settings_on(built.device)
    events.send(built.started(hyperparameters=settings.model_dump(), resumed_at_step=task.checkpoint_step))
    if differs := built.other_versions(task.made_with):
        events.send(Noted(text=differs))
    if task.new_clips:
        events.send(Noted(text=_NEW_CLIPS))
    if lends_to_few := why_it_lends_to_few(built.job, settings):
        events.send(Noted(text=lends_to_few))
    check_memory(built.job.memory_on(built.device, built.num_devices), built.device, task.gpu_part)
    run, policies = begin_or_resume(task, spec, settings, built, events)
    exports = ExportWriter(settings.algorithm(), built)
    files = PolicyFiles(policies, exports, task.best)
    battery = None if spec.battery is None else BatteryWriter(spec.battery, built, lambda: stopping.asked)

    def prepare() -> None:
        if built.device == "gpu":  # It leaves the processor idle.
            exports.prepare()
            if battery is not None:
                battery.prepare(policies[0])

    videos = None if spec.video is None else PolicyVideos(spec.video, built, policies)
    held = getattr(settings, "action_repeat", 1)  # Q-learning, which lacks it, tells of no lost body.
    keep_lost = partial(keep_lost_body, built=built, action_repeat=held, events=events)
    report = Report(events, run, spec.checkpoints.every_seconds, keep_lost, prepare)
    was_stopped = _publish_all(run, files, videos, spec, report, stopping)
    if task.gang is not None and isinstance(run, Run):
        run.end()
    if battery is not None and not was_stopped:
        report.enter("testing")
        with stopping.nothing_to_keep():
            battery.test_trained(policies)
    return was_stopped


def follow(task: Task, spec: TrainSpec, built: BuiltEnvironment, events: EventWriter) -> None:
    """Take part in the training that the process on another host leads, to its end."""
    settings = built.job.settings_on(built.device)
    check_memory(built.job.memory_on(built.device, built.num_devices), built.device)
    run, _ = begin_or_resume(task, spec, settings, built, events)
    if isinstance(run, Run):
        run.follow()


class FollowedRun(Protocol):
    """The run as a training uses it: see `core.algorithms.run.Run`, and `SeedsRun`."""

    @property
    def step(self) -> int: ...

    @property
    def total(self) -> int: ...

    def events(self) -> Generator[Event]: ...

    def checkpoint(self) -> bytes: ...

    def tables(self) -> Mapping[str, NDArray[Any]]: ...


def _publish_all(  # the run, and its receivers
    run: FollowedRun,
    files: PolicyFiles,
    videos: PolicyVideos | None,
    spec: TrainSpec,
    report: "Report",
    stopping: StopRequest,
) -> bool:
    """Turn the run's events into messages and files; see `train`."""
    report.enter("compiling")
    try:
        with closing(run.events()) as told:
            for event in told:
                if isinstance(event, TrainingProgress):
                    stopping.keep_before_leaving()
                report.publish(event)
                if isinstance(event, Evaluated):
                    files.see(event)
                if stopping.asked:
                    break
                is_kept = isinstance(event, CheckpointReady)
                if isinstance(event, TrainingProgress):
                    is_kept = report.keep_checkpoint_if_due()
                if is_kept and run.step < run.total:
                    with stopping.nothing_to_keep():
                        files.keep_newest()
                if isinstance(event, CheckpointReady) and videos:
                    with stopping.nothing_to_keep():
                        videos.at_checkpoint(event.step, report.enter, is_last=run.step >= run.total)
    except JobFailed:
        report.keep_checkpoint()  # The last good one.
        files.keep_best()
        raise
    report.keep_checkpoint()
    with stopping.nothing_to_keep():
        files.keep_best()
        files.keep_last()
        with _tables(run, spec, report.events):
            if videos:
                report.enter("drawing")
                videos.take("video")
    return stopping.asked and run.step < run.total


def _tables(run: FollowedRun, spec: TrainSpec, events: EventWriter) -> AbstractContextManager[None]:
    """Keeps the tables that the run shows, if it does; they are drawn while the block runs."""
    tables = run.tables()
    return kept_with_tables(events, tables, run.step, spec.environment.id) if tables else nullcontext()


def begin_or_resume(
    task: Task, spec: TrainSpec, settings: BaseSpec, built: BuiltEnvironment, events: EventWriter
) -> tuple[FollowedRun, Sequence[PolicyInTraining]]:
    """A run of the algorithm that the settings name, and the policies that it trains.

    It resumes from the task's checkpoint, if it has one.
    """
    resume = (events.spool / task.checkpoint).read_bytes() if task.checkpoint else None
    every = _steps_between_checkpoints(spec, settings)
    if spec.seeds is None:
        run = make_run(
            built.environment,
            settings,
            seed=spec.seed,
            checkpoint_every_steps=every,
            resume=resume,
            devices=built.num_devices,
            new_clips=task.new_clips,
            experts=[
                load_policy((events.spool / path).read_bytes(), kind, is_checkpoint=False)
                for path, kind in task.experts
            ],
        )
        return run, [PolicyInTraining(spec, events, lambda: run.step, run.policy)]
    together = make_seeds_run(
        built.environment,
        settings,
        seeds=spec.seeds,
        checkpoint_every_steps=every,
        resume=resume,
        new_clips=task.new_clips,
    )
    return together, [
        PolicyInTraining(
            spec.of_seed(seed),
            events.of_seed(seed),
            partial(together.step_of, seed),
            partial(together.policy, seed),
            seed,
        )
        for seed in spec.seeds
    ]


def _steps_between_checkpoints(spec: TrainSpec, settings: BaseSpec) -> int:
    """Environment steps from one checkpoint to the next."""
    return spec.checkpoints.every_steps or max(1, settings.budget // _CHECKPOINTS)


@dataclass
class Report:
    """Turns a run's events into messages; remembers the last checkpoint kept.

    prepare: called once, when the run begins to train.
    """

    events: EventWriter
    run: FollowedRun
    checkpoint_every_s: float = float("inf")
    keep_lost: Callable[[BodyLost], None] = lambda _: None
    prepare: Callable[[], None] = lambda: None
    _kept_step: int | None = None
    _kept_at: float = field(default_factory=time.monotonic)
    _warned_of: set[str] = field(default_factory=set[str])
    _started: tuple[float, int] = (0.0, 0)
    # Steps a second as the run has measured them, until there is a longer time to judge by.
    _rate: float | None = None
    _peak_bytes: int = 0

    def enter(self, phase: JobPhase) -> None:
        """Tell that the process does this from now on."""
        self.events.send(PhaseBegan(phase=phase))

    def publish(self, event: Event) -> None:
        match event:
            case Phase(name=name, seconds=seconds):
                self.events.send(PhaseEnded(name=name, seconds=seconds))
                if name == "compile":
                    self.enter("training")
                    self.prepare()
            case TrainingProgress(step=step, total=total, metrics=metrics):
                self._warn(step, metrics)
                self._rate = metrics.get("training/sps", self._rate)
                self._measured(step, metrics, total)
                self._note_peak()
            case Evaluating():
                self.enter("evaluating")
            case Evaluated(step=step, metrics=metrics):
                self.enter("training")
                self._measured(step, metrics, self.run.total)
                self._note_peak()
            case CheckpointReady():
                self.keep_checkpoint()
            case BodyLost():
                self.keep_lost(event)
            case SeedDiverged(seed=seed, detail=detail):
                self.events.send(Noted(text=f"Seed {seed} has diverged and is trained no further. {detail}"))

    def keep_checkpoint(self) -> None:
        """Keep a checkpoint of the present state, unless there is one already."""
        step = self.run.step
        if step != self._kept_step:
            name = f"checkpoint-{step:012d}.msgpack"
            self.events.keep(name, self.run.checkpoint(), "checkpoint", "application/msgpack", step=step)
            self._kept_step = step
        self._kept_at = time.monotonic()

    def keep_checkpoint_if_due(self) -> bool:
        """Keep a checkpoint if the last one is older than `checkpoint_every_s`; returns whether it was."""
        is_due = time.monotonic() - self._kept_at >= self.checkpoint_every_s
        if is_due:
            self.keep_checkpoint()
        return is_due

    def _note_peak(self) -> None:
        """Tell of the most memory so far, if that is more than what was told by a hundredth."""
        peak = _device_memory("peak_bytes_in_use") or 0
        if peak > _NEWS_OF_PEAK * self._peak_bytes:
            self._peak_bytes = peak
            self.events.send(MemoryPeak(bytes=peak))

    def _warn(self, step: int, metrics: Mapping[str, float]) -> None:
        """Warn once per kind. How often it happens is a metric, except for numbers that are not finite."""
        for name, value in metrics.items():
            if not math.isfinite(value) and name not in self._warned_of:
                self._warned_of.add(name)
                text = f"By step {step}, the metric {name} was not finite; its curve lacks such values."
                self.events.send(Noted(text=text))
        for name, what in _WARNINGS.items():
            if metrics.get(name, 0.0) > 0 and name not in self._warned_of:
                self._warned_of.add(name)
                self.events.send(Noted(text=f"By step {step}, {what}"))

    def _measured(self, step: int, metrics: Mapping[str, float], total: int) -> None:
        self.events.send(Measured(step=step, values=dict(metrics)))
        now = time.monotonic()
        if self._started == (0.0, 0):
            self._started = (now, step)
        began, first_step = self._started
        rate = (step - first_step) / (now - began) if step > first_step else self._rate
        eta_s = max(0, total - step) / rate if rate else None
        self.events.send(Advanced(step=step, total=total, steps_per_second=rate, eta_s=eta_s))


def check_memory(least: MemoryNeed, device: Device, gpu_part: float | None = None) -> None:
    """Raises JobFailed if the device, or for a CPU its machine, has less memory than the run needs.

    gpu_part: of the GPU's memory, if the job shares the GPU.
    """
    limit = allowed_bytes(None) if device == "cpu" else _device_memory("bytes_limit")
    if limit is not None and least.bytes > limit:
        where = f"this worker's {device.upper()}" if gpu_part is None else "the job's part of a GPU"
        # Not `out_of_host_memory`, which another process may have caused and which is retried.
        raise JobFailed(Reason.OUT_OF_MEMORY, least.does_not_fit(limit, where))


def _device_memory(name: str) -> int | None:
    """What XLA counts of the first GPU's memory, in bytes; None if it does not, as on a CPU.

    name: `bytes_limit`, what it may use; or `peak_bytes_in_use`.
    """
    counted = jax.local_devices()[0].memory_stats()
    return counted.get(name) if counted else None
