"""A training job: the events of a run become messages and files."""

import math
import time
from collections.abc import Generator, Mapping
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

from numpy.typing import NDArray

from core.algorithms.catalog import least_memory, resolve
from core.algorithms.events import CheckpointReady, Evaluated, Evaluating, Event, Phase, Progress
from core.algorithms.policy import load_policy
from core.algorithms.run import Run, make_run
from core.algorithms.spec import BaseSpec
from core.errors import JobFailed
from core.jobs.job import JobPhase
from core.jobs.spec import TrainSpec, VideoSpec
from worker.protocol import Advanced, BestSoFar, Measured, Noted, PhaseBegan, PhaseEnded, Task
from worker.training.best_policy import BestPolicy
from worker.training.built_environment import BuiltEnvironment
from worker.training.event_writer import EventWriter
from worker.training.exports import ExportWriter
from worker.training.memory import check_memory
from worker.training.pictures import kept_with_tables
from worker.training.replays import ReplayWriter
from worker.training.stopping import StopRequest
from worker.training.time_budget import TimeBudget
from worker.training.video import VideoRecorder

# A tenth of the budget lies between checkpoints where the job does not say.
_CHECKPOINTS = 10

# Sentences for the job's events. Each is sent the first time that its metric is above 0.
_WARNINGS = {
    "training/physics_overflow": "the engine's buffers were too small for some environments, and contacts "
    "were lost (training/physics_overflow is the share of steps). Choose another engine by `physics` if that "
    "matters.",
    "training/lost_bodies": "an engine lost the state of a body: its values were not finite, and its "
    "episode ended (training/lost_bodies is the share of steps). Stiff contacts, strong actuators or a long "
    "timestep can be the cause.",
}


def train(
    task: Task, spec: TrainSpec, built: BuiltEnvironment, events: EventWriter, stopping: StopRequest
) -> bool:
    """Train to the end or to a stop; whether a stop cut it short.

    Keeps checkpoints, the newest one's policy as `policy.npz`, and the best evaluation's as `policy-best`;
    and at the end, unless the job continues elsewhere, its policy, both also for programs elsewhere, and the
    video that it asks for.
    """
    settings = resolve(spec.algorithm, built.info, built.device)
    events.send(built.started(hyperparameters=settings.model_dump(), resumed_at_step=task.checkpoint_step))
    check_memory(least_memory(settings, built.info, built.num_devices), built.device)
    run = begin_or_resume(task, spec, settings, built, events)
    return follow(run, spec, settings, built, events, stopping, best_before=task.best)


class FollowedRun(Protocol):
    """What a training asks of its run: see `core.algorithms.run.Run`."""

    @property
    def step(self) -> int: ...

    @property
    def total(self) -> int: ...

    def events(self) -> Generator[Event]: ...

    def checkpoint(self) -> bytes: ...

    def policy(self) -> bytes: ...

    def tables(self) -> Mapping[str, NDArray[Any]]: ...


def follow(  # noqa: PLR0913 # What runs, and what is done with it.
    run: FollowedRun,
    spec: TrainSpec,
    settings: BaseSpec,
    built: BuiltEnvironment,
    events: EventWriter,
    stopping: StopRequest,
    *,
    best_before: BestSoFar | None,
    others_wait: bool = False,
) -> bool:
    """Turn the run's events into messages and files; see `train`.

    best_before: the best evaluation's policy of the attempts before. others_wait: for as long as this takes.
    """
    report = Report(events, run, spec.checkpoints.every_seconds)
    report.enter("compiling")
    exports, best = ExportWriter(settings.algorithm(), built, events), BestPolicy(events, best_before)
    videos = (
        None if spec.video is None else PolicyVideos(spec, spec.video, built, events, run, not others_wait)
    )
    try:
        with closing(run.events()) as told:
            for event in told:
                if isinstance(event, Progress):
                    stopping.keep_before_leaving()
                report.publish(event)
                if isinstance(event, Evaluated):
                    best.see(event, run.policy)
                if stopping.asked:
                    break
                is_kept = isinstance(event, CheckpointReady)
                if isinstance(event, Progress):
                    is_kept = report.keep_checkpoint_if_due()
                if is_kept and not others_wait and run.step < run.total:
                    with stopping.nothing_to_keep():
                        exports.keep_newest(run.policy, run.step)
                if isinstance(event, CheckpointReady) and videos:
                    with stopping.nothing_to_keep():
                        videos.at_checkpoint(event.step, report)
    except JobFailed:
        report.keep_checkpoint()  # The last good one.
        best.keep_exports(exports)
        raise
    report.keep_checkpoint()
    with stopping.nothing_to_keep():
        policy = run.policy()
        best.keep_exports(exports)
        exports.keep_last(policy, run.step)
        # After those: with this one the job has its final policy, in whatever form.
        events.keep("policy", policy, "policy", "application/octet-stream", step=run.step)
        with _tables(run, spec, events):
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
) -> Run[Any]:
    """A run of the algorithm that the settings name; it resumes from the task's checkpoint, if it has one."""
    resume = (events.spool / task.checkpoint).read_bytes() if task.checkpoint else None
    return make_run(
        built.environment,
        settings,
        seed=spec.seed,
        checkpoint_every_steps=steps_between_checkpoints(spec, settings),
        resume=resume,
        devices=built.num_devices,
    )


def steps_between_checkpoints(spec: TrainSpec, settings: BaseSpec) -> int:
    """Environment steps from one checkpoint to the next."""
    return spec.checkpoints.every_steps or max(1, settings.budget // _CHECKPOINTS)


@dataclass
class PolicyVideos:
    """Videos and replays of a run's policy as it is at the time; it is compiled for the first of them.

    has_time: whether to make replays that nobody asked for.
    """

    spec: TrainSpec
    video: VideoSpec
    built: BuiltEnvironment
    events: EventWriter
    run: FollowedRun
    has_time: bool = True
    _film: VideoRecorder | None = None
    _budget: TimeBudget = field(default_factory=TimeBudget)

    def at_checkpoint(self, step: int, report: "Report") -> None:
        """Keep a video, where the job asks for one; otherwise a replay, where that costs next to nothing."""
        if self.video.every_checkpoint:
            report.enter("drawing")
            self.take(f"video-{step:012d}")
            report.enter("training")
        elif self.has_time and step < self.run.total and self._budget.allows_another():
            began = time.monotonic()
            report.enter("drawing")
            film, parameters = self._filmed()
            film.replay(f"-{step:012d}", parameters, step)
            self._budget.spent(began)
            report.enter("training")

    def take(self, name: str) -> None:
        """Keep a video of the present step as `<name>.mp4`."""
        film, parameters = self._filmed()
        film.shoot(name, parameters, self.run.step)

    def _filmed(self) -> tuple[VideoRecorder, Any]:
        """The recorder, and the policy's parameters as they are now."""
        # Not from a checkpoint, which may hold a replay buffer.
        policy = load_policy(self.run.policy(), self.spec.algorithm.algorithm(), is_checkpoint=False)
        if self._film is None:
            env, act = policy.acting(self.built.environment)
            built = replace(self.built, environment=env)
            replays = ReplayWriter(built, self.events)
            self._film = VideoRecorder(self.spec, self.video, built, act, self.events, replays)
        return self._film, policy.parameters


@dataclass
class Report:
    """Turns a run's events into messages; remembers the newest metrics, and the last checkpoint kept."""

    events: EventWriter
    run: FollowedRun
    checkpoint_every_s: float = float("inf")
    _metrics: dict[str, float] = field(default_factory=dict[str, float])
    _kept_step: int | None = None
    _kept_at: float = field(default_factory=time.monotonic)
    _warned_of: set[str] = field(default_factory=set[str])
    _started: tuple[float, int] = (0.0, 0)

    def enter(self, phase: JobPhase) -> None:
        """Tell that the process does this from now on."""
        self.events.send(PhaseBegan(phase=phase))

    def publish(self, event: Event) -> None:
        match event:
            case Phase(name=name, seconds=seconds):
                self.events.send(PhaseEnded(name=name, seconds=seconds))
                if name == "compile":
                    self.enter("training")
            case Progress(step=step, total=total, metrics=metrics):
                self._metrics.update(metrics)
                self._warn(step, metrics)
                self.events.send(Measured(step=step, values=dict(metrics)))
                self.events.send(self._advanced(step, total))
            case Evaluating():
                self.enter("evaluating")
            case Evaluated(step=step, metrics=metrics):
                self._metrics.update(metrics)
                self.enter("training")
                self.events.send(Measured(step=step, values=dict(metrics)))
                self.events.send(self._advanced(step, self.run.total))
            case CheckpointReady():
                self.keep_checkpoint()

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

    def _warn(self, step: int, metrics: Mapping[str, float]) -> None:
        """Of each once; how often it happens from then on is a metric, but for one that is no number."""
        for name, value in metrics.items():
            if not math.isfinite(value) and name not in self._warned_of:
                self._warned_of.add(name)
                text = f"By step {step}, the metric {name} was not finite; its curve lacks such values."
                self.events.send(Noted(text=text))
        for name, what in _WARNINGS.items():
            if metrics.get(name, 0.0) > 0 and name not in self._warned_of:
                self._warned_of.add(name)
                self.events.send(Noted(text=f"By step {step}, {what}"))

    def _advanced(self, step: int, total: int) -> Advanced:
        now = time.monotonic()
        if self._started == (0.0, 0):
            self._started = (now, step)
        began, first_step = self._started
        rate = (step - first_step) / (now - began) if step > first_step else self._metrics.get("training/sps")
        eta_s = max(0, total - step) / rate if rate else None
        return Advanced(
            step=step, total=total, steps_per_second=rate, eta_s=eta_s, metrics=dict(self._metrics)
        )
