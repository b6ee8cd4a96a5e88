"""A job's progress on a terminal: a live bar, or plain lines where there is no terminal."""

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Self

from rich.console import RenderableType
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn
from rich.text import Text

from gaitway.cli.terminal import Console
from gaitway.frames import RETURNS, sparkline
from gaitway.schema import JobView
from gaitway.views import Event

_SPEED = ("eval/forward_speed", "training/forward_speed")
_WORDS = {"drawing": "drawing the video", "testing": "testing in C MuJoCo"}
# Nothing else is told meanwhile, and it lasts from a second to minutes.
_COMPILING = "the first time may take minutes, a later start of the same job is shorter"
# These follow one another with each evaluation: no news where every piece of it is a line.
_ROUTINE = {"training", "evaluating"}
_HELD = {"starting", "running", "cancelling"}


@dataclass
class History:
    """One metric over rising steps."""

    steps: list[int] = field(default_factory=list[int])
    values: list[float] = field(default_factory=list[float])

    def add(self, step: int, value: float | None) -> None:
        """Append a value. One of an earlier step comes from an attempt that began again at a checkpoint: it
        replaces what followed that checkpoint. None, a value that was not finite, is left out."""
        if value is None:
            return
        while self.steps and self.steps[-1] >= step:
            self.steps.pop()
            self.values.pop()
        self.steps.append(step)
        self.values.append(value)


class JobProgress:
    """Shows steps, steps/s, return and its curve, forward speed, elapsed time and ETA from events and jobs.

    It also shows episodes, where the algorithm's budget counts these.
    every_s: seconds between two plain lines. Use it as a context manager.
    """

    def __init__(self, console: Console | None = None, *, every_s: float = 5.0) -> None:
        self.status = "queued"
        self.step = 0
        self.total = 0
        self.steps_per_second: float | None = None
        self.eta_s: float | None = None
        self.metrics: dict[str, float] = {}
        self.phase: str | None = None
        self._returns = {name: History() for name in RETURNS}
        self._console = console or Console()
        self._every_s = every_s
        self._told_at = float("-inf")
        self._told = ""
        self._bar = _TwoLines(
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=None),
            TaskProgressColumn(),
            TextColumn("{task.fields[left]}", markup=False),
            TimeElapsedColumn(),
            console=self._console,
            expand=True,
        )
        self._task = self._bar.add_task(self.status, total=None, left="")

    def __enter__(self) -> Self:
        if self._console.is_terminal:
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._show(is_news=True)
        if self._console.is_terminal:
            self._bar.stop()

    def update(self, news: Event | JobView) -> None:
        """Show an event, or the job's new state."""
        is_news = self._take_job(news) if isinstance(news, JobView) else self._take_event(news)
        self._show(is_news=is_news)

    @property
    def doing(self) -> str:
        """The status, and the phase where there is one."""
        return f"{self.status} · {_WORDS.get(self.phase, self.phase)}" if self.phase else self.status

    @property
    def left(self) -> str:
        """The time that is left; empty where it is not known."""
        return f"ETA {duration(self.eta_s)}" if self.eta_s is not None and self.step < self.total else ""

    @property
    def facts(self) -> str:
        """The numbers as one line; unknown ones are left out."""
        return " · ".join([*self._numbers(self._curve), *([self.left] if self.left else [])])

    def _numbers(self, curve: str) -> list[str]:
        """curve: stands behind the return."""
        parts = [f"{self.step:,}/{self.total:,} steps"] if self.total else []
        if self.phase == "compiling":
            parts.append(_COMPILING)
        if (episodes := self.metrics.get("training/num_episodes")) is not None:
            done = self.metrics.get("training/episodes", 0.0)
            parts.insert(0, f"{done:,.0f}/{episodes:,.0f} episodes")
        if self.steps_per_second and self.phase != "testing":  # It trains no more.
            parts.append(f"{self.steps_per_second:,.0f} steps/s")
        if (reward := self._first(RETURNS)) is not None:
            parts.append(f"return {reward:,.1f} {curve}".rstrip())
        if (speed := self._first(_SPEED)) is not None:
            parts.append(f"{speed:.2f} m/s")
        return parts

    @property
    def _curve(self) -> str:
        """The return so far in one line of characters; empty where the terminal has none of these."""
        if not self._console.encoding.startswith("utf"):
            return ""
        for history in self._returns.values():
            if len(history.values) > 1:
                return sparkline(history.values)
        return ""

    def _first(self, names: tuple[str, ...]) -> float | None:
        return next((self.metrics[name] for name in names if name in self.metrics), None)

    def _take_job(self, job: JobView) -> bool:
        is_news = job.status != self.status
        self.status = job.status
        self._take_metrics(job.progress.metrics)
        return self._take_progress(job.progress.model_dump()) or is_news

    def _take_event(self, event: Event) -> bool:
        if event.kind == "status":
            self.status = str(event.data.get("status", self.status))
            if self.status not in _HELD:
                self.phase = None
        elif event.kind == "progress":
            return self._take_progress(event.data)
        elif event.kind == "metrics":
            self._take_metrics(event.data.get("values") or {})
            self._take_returns(event.data)
        elif event.kind == "note":
            self._console.print(Text(str(event.data.get("text", "")), style="yellow"))
        return event.kind == "status"

    def _take_progress(self, data: Mapping[str, Any]) -> bool:
        """Whether another phase began that is no routine."""
        before, self.phase = self.phase, data.get("phase")
        self.step = int(data.get("step") or 0)
        self.total = int(data.get("total") or 0)
        self.steps_per_second = data.get("steps_per_second")
        self.eta_s = data.get("eta_s")
        return self.phase != before and not {before, self.phase} <= _ROUTINE

    def _take_metrics(self, values: Mapping[str, float | None]) -> None:
        self.metrics.update({name: value for name, value in values.items() if value is not None})

    def _take_returns(self, data: Mapping[str, Any]) -> None:
        values: Mapping[str, float | None] = data.get("values") or {}
        for name, history in self._returns.items():
            history.add(int(data.get("step") or 0), values.get(name))

    def _show(self, *, is_news: bool) -> None:
        if self._console.is_terminal:
            self._bar.update(
                self._task,
                description=self.doing,
                total=self.total or None,
                completed=self.step,
                left=self.left,
            )
            # Text that does not fit is cut at the end, where the curve stands.
            self._bar.second = " · ".join(part for part in (*self._numbers(""), self._curve) if part)
            return
        line = " · ".join(part for part in (self.doing, self.facts) if part)
        now = time.monotonic()
        if line != self._told and (is_news or now - self._told_at >= self._every_s):
            self._told, self._told_at = line, now
            self._console.print(Text(line), soft_wrap=True)


class _TwoLines(Progress):
    """A bar, and numbers below it: side by side they leave a terminal of 80 columns no bar."""

    second = ""

    def get_renderables(self) -> Iterable[RenderableType]:
        yield from super().get_renderables()
        yield Text(self.second, no_wrap=True, overflow="ellipsis")


def duration(seconds: float) -> str:
    """`9 s`, `2:05`, `1:00:09`."""
    whole = max(0, round(seconds))
    if whole < 60:
        return f"{whole} s"
    minutes, second = divmod(whole, 60)
    hours, minute = divmod(minutes, 60)
    return f"{hours}:{minute:02d}:{second:02d}" if hours else f"{minute}:{second:02d}"
