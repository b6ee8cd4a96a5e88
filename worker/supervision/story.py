"""The lines that a supervisor writes into its job's log, so that one can read afterwards what happened."""

import json
import textwrap
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from core.jobs.job import Job, JobPhase, utc_now
from core.jobs.spec import CheckpointPolicy, RolloutSpec, TrainSpec
from worker.protocol import FileReady, Hello, Measured, Message, Noted, PhaseBegan, PhaseEnded, Started
from worker.supervision.outcome import Outcome

_WIDTH = 110
_LONGEST_VALUE = 120
_PARTS = {"import": "Imported", "trace": "Traced", "compile": "Compiled", "first_update": "First update"}
# An evaluation's line: each metric, and how it reads.
_EVALUATED = {
    "eval/episode_reward": "return {:.4g}",
    "eval/episode_reward_std": "± {:.3g}",
    "eval/forward_speed": "{:.2f} m/s",
    "eval/avg_episode_length": "{:.0f} steps an episode",
    "eval/epoch_eval_time": "in {:.1f} s",
}


class Story:
    """Turns an attempt's messages into lines, each with its time. clock: seconds.

    Its lines are of the log alone: the events and the checkpoints know nothing of them.
    """

    def __init__(self, job: Job, spool: Path, clock: Callable[[], float] = time.monotonic) -> None:
        self._job, self._spool, self._clock = job, spool, clock
        self._phase: JobPhase = "preparing"
        self._since = clock()
        self._seconds = defaultdict[str, float](float)
        self._began = self._since
        self._first_sign_s: float | None = None

    def begin(self) -> Iterator[str]:
        """Who does what, and why again."""
        number, attempt = len(self._job.attempts), self._job.attempts[-1]
        yield from timed(f"Attempt {number} on worker {attempt.worker}, {utc_now():%Y-%m-%d}. Times are UTC.")
        if number > 1 and (before := self._job.attempts[-2]).reason is not None:
            yield from timed(f"Attempt {number - 1} ended as {before.reason}: {before.message}")
        yield from timed(_asked(self._job))
        if self._job.correlation_id is not None:
            yield from timed(f"The logs of the service name it by the request {self._job.correlation_id}")

    def lines(self, message: Message) -> Iterator[str]:
        """The lines for a message; most have none."""
        match message:
            case Hello():
                self._first_sign_s = self._clock() - self._began
            case PhaseBegan(phase=phase):
                self._enter(phase)
            case Started():
                yield from self._started(message)
            case PhaseEnded(name=name, seconds=seconds) if name in _PARTS:
                yield from timed(f"{_PARTS[name]} in {seconds:.1f} s")
            case Measured(step=step, finite=values) if any(name.startswith("eval/") for name in values):
                yield from timed(f"Step {step:,}: {_evaluated(values)}")
            case FileReady(role="best_policy", step=step, metadata=facts):
                of_seed = f" of seed {facts['seed']}" if "seed" in facts else ""
                yield from timed(
                    f"Step {step or 0:,}: the best evaluation{of_seed} so far, with a return of "
                    f"{_value(facts.get('return'))}; its policy is kept"
                )
            case FileReady(role="checkpoint" | "video"):
                yield from timed(self._file(message))
            case Noted(text=text):
                yield from timed(f"Note: {text}")
            case _:
                pass

    def end(self, outcome: Outcome) -> Iterator[str]:
        """How it ended, and how long each phase took."""
        self._enter(self._phase)
        took = ", ".join(f"{phase} {seconds:.1f} s" for phase, seconds in self._seconds.items())
        yield from timed(f"Seconds by phase: {took}")
        yield from timed(ending(outcome))

    def seconds(self) -> Iterator[tuple[str, float]]:
        """How long each phase took, after `end`.

        `waiting`: for a worker. `starting`: until the training process ran; a part of `preparing`.
        """
        attempt, before = self._job.attempts[-1], self._job.attempts[:-1]
        since = before[-1].ended_at if before else self._job.created_at
        if since is not None:
            yield "waiting", max(0.0, (attempt.started_at - since).total_seconds())
        if self._first_sign_s is not None:
            yield "starting", self._first_sign_s
        yield from self._seconds.items()

    def _enter(self, phase: JobPhase) -> None:
        now = self._clock()
        self._seconds[self._phase] += now - self._since
        self._phase, self._since = phase, now

    def _started(self, started: Started) -> Iterator[str]:
        facts = started.details
        yield from timed(f"Device: {started.device}, of {facts.get('host')}")
        yield from timed(f"Engine: {started.engine}. {facts.get('engine_reason', '')}")
        versions = {"python": facts.get("python"), **facts.get("versions", {}), "commit": facts.get("commit")}
        yield from timed(", ".join(f"{name} {value}" for name, value in versions.items() if value))
        if (used := facts.get("hyperparameters")) and isinstance(self._job.spec, TrainSpec):
            sent = self._job.spec.algorithm.model_dump(exclude_unset=True, exclude={"kind"})
            filled = {name: value for name, value in used.items() if name not in sent}
            yield from timed(f"Settings that the job names: {_settings(sent)}")
            yield from timed(f"Settings that were filled in: {_settings(filled)}")
        if step := facts.get("resumed_at_step"):
            yield from timed(f"The run resumes from the checkpoint of step {step:,}")

    def _file(self, file: FileReady) -> str:
        what = f"Checkpoint of step {file.step or 0:,}" if file.role == "checkpoint" else file.name
        with suppress(OSError):  # It may be stored and removed already.
            return f"{what}: {_size((self._spool / file.path).stat().st_size)}"
        return what


def ending(outcome: Outcome) -> str:
    """How an attempt ended, in a line."""
    how = f"The job has {outcome.status}" if outcome.status else "The job goes back to the queue"
    return f"{how} ({outcome.reason}). {outcome.message}"


def timed(text: str) -> Iterator[str]:
    """A line that begins with its time; what is long goes on below, indented."""
    yield from textwrap.wrap(
        text,
        _WIDTH,
        initial_indent=f"{utc_now():%H:%M:%S}  ",
        subsequent_indent=" " * 10,
        break_long_words=False,
        break_on_hyphens=False,
    )


def _asked(job: Job) -> str:
    spec = job.spec
    options = f" with {_settings(spec.environment.options)}" if spec.environment.options else ""
    seeds = f"seeds {', '.join(map(str, job.seeds))}" if job.seeds else f"seed {spec.seed}"
    about = f"{spec.kind} {spec.environment.id}{options}, {seeds}"
    match spec:
        case RolloutSpec(policy=CheckpointPolicy(job=of, which="best")):
            return f"{about}, {spec.num_episodes} episodes of the policy of the best evaluation of job {of}"
        case RolloutSpec(policy=CheckpointPolicy(job=of, step=step)):
            which = "newest checkpoint" if step is None else f"checkpoint of step {step:,}"
            return f"{about}, {spec.num_episodes} episodes of the policy in the {which} of job {of}"
        case RolloutSpec():
            return f"{about}, {spec.num_episodes} episodes of the {spec.policy.kind} policy"
        case TrainSpec(resume_from=point):
            resumed = "" if point is None else f", resumed from job {point.job}"
            return f"{about}, {spec.algorithm.algorithm()}{resumed}"


def _settings(values: Mapping[str, Any]) -> str:
    return ", ".join(f"{name}={_value(value)}" for name, value in values.items()) or "none"


def _value(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    text = value if isinstance(value, str) else json.dumps(value, default=str)
    return text if len(text) <= _LONGEST_VALUE else f"{text[:_LONGEST_VALUE]}…"


def _evaluated(values: Mapping[str, float | None]) -> str:
    found = {name: value for name in _EVALUATED if (value := values.get(name)) is not None}
    sentences = [_EVALUATED[name].format(value) for name, value in found.items()]
    return ", ".join(sentences).replace(", ±", " ±") or "evaluated"


def _size(num_bytes: int) -> str:
    return f"{num_bytes / 1e6:.1f} MB" if num_bytes >= 1e6 else f"{num_bytes / 1e3:.1f} kB"
