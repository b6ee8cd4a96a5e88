"""Where the time of a training goes: `gaitway profile job.json`."""

import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from core.algorithms.events import Event, Phase, TrainingProgress
from core.errors import Rejected
from core.jobs.spec import TrainSpec
from gaitway.service.foreground import Told, begin, device_of, training
from worker.protocol import Task

if TYPE_CHECKING:
    from core.algorithms.algorithm import RunSettings
    from core.algorithms.profiling import UpdateTimes

_COMPILE = ("trace", "compile")


@dataclass
class Times:
    """The seconds of a training's parts, from its events.

    training: in epochs, without the first update, which also warms up; `steps` environment steps were taken
    in them. evaluation: one. total: until all of these are over.
    """

    compile: float = 0.0
    first_update: float = 0.0
    training: float = 0.0
    evaluation: float = 0.0
    total: float = 0.0
    steps: int = 0
    updates: int = 0
    _began_at: tuple[float, int] | None = field(default=None)

    def see(self, event: Event, steps_per_update: int) -> None:
        match event:
            case Phase(name="first_update", seconds=seconds):
                self.first_update = seconds
            case Phase(name=name, seconds=seconds) if name in _COMPILE:
                self.compile += seconds
            case TrainingProgress(step=step, metrics=metrics):
                walltime = metrics["training/walltime"]
                if self._began_at is None:
                    self._began_at = walltime, step
                self.training, self.steps = walltime - self._began_at[0], step - self._began_at[1]
                self.updates = self.steps // steps_per_update
            case _:
                pass


def profile(
    document: dict[str, Any], out: Path, *, gpus: int, model: Path | None, epochs: int, trace: Path | None
) -> Iterator[str]:
    """Train for so many epochs, of a second each, and yield the lines of a table.

    trace: a folder for JAX's trace of one more epoch. Raises GaitwayError as `run_job`, and Rejected for a
    job of several seeds.
    """
    began = time.perf_counter()
    spec = training(document).model_copy(update={"video": None})
    if spec.seeds is not None:
        raise Rejected("A profile is that of one seed: write `seed` instead of `seeds`.")
    trace = trace and trace.resolve()
    task = begin(spec, out, device=device_of(gpus), model=model)
    yield from _profile(task, spec, epochs, trace, began)


def _profile(task: Task, spec: TrainSpec, epochs: int, trace: Path | None, began: float) -> Iterator[str]:
    import jax

    from core.algorithms.run import Run
    from worker.training.built_environment import build_environment
    from worker.training.train import Report, begin_or_resume

    events = Told(Path.cwd(), keeps_rows=False)
    built = build_environment(task)
    settings = built.job.settings_on(built.device)
    events.send(built.started(hyperparameters=settings.model_dump()))
    run = cast("Run[Any]", begin_or_resume(task, spec, settings, built, events)[0])
    report, times = Report(events, run), Times()
    steps_per_update = cast("RunSettings", settings).env_steps_per_update
    with closing(run.events()) as told:
        seen = 0
        for event in told:
            report.publish(event)
            times.see(event, steps_per_update)
            seen += isinstance(event, TrainingProgress)
            if seen > epochs:  # The first has the first update alone.
                break
        if not times.updates:
            raise Rejected("The job ends with its first update: give it more steps.")
        started = time.perf_counter()
        run.evaluate(spec.seed)
        times.evaluation, times.total = time.perf_counter() - started, time.perf_counter() - began
        if trace is not None:
            with cast("Any", jax.profiler).trace(trace, create_perfetto_trace=True):
                next((event for event in told if isinstance(event, TrainingProgress)), None)
    yield from table(times, run.update_times(built.environment))
    if trace is not None:
        yield f"The trace of one more epoch is in {trace}: `tensorboard --logdir`, or ui.perfetto.dev."


def table(times: Times, parts: "UpdateTimes | None") -> Iterator[str]:
    """The shares of indented rows are those of the epochs."""
    known = times.compile + times.first_update + times.training + times.evaluation
    rows = [
        ("compile", times.compile, times.total),
        ("first update", times.first_update, times.total),
        (f"{times.updates:,} updates", times.training, times.total),
        *_rows(times, parts),
        ("one evaluation", times.evaluation, times.total),
        ("other", times.total - known, times.total),
        ("total", times.total, times.total),
    ]
    yield f"{'':<20}{'seconds':>10}{'share':>8}"
    for name, seconds, whole in rows:
        yield f"{name:<20}{seconds:>10.3f}{seconds / whole:>8.0%}"
    yield f"{times.steps / times.training:,.0f} steps/s"


def _rows(times: Times, parts: "UpdateTimes | None") -> Iterator[tuple[str, float, float]]:
    if parts is None:
        return
    experience = min(parts.experience * times.updates, times.training)
    physics = min(parts.physics * times.updates, experience)
    yield "  experience", experience, times.training
    yield "    physics", physics, times.training
    yield "    policy, resets", experience - physics, times.training
    yield "  learning", times.training - experience, times.training
