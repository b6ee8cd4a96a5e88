"""One run of any algorithm: begin or resume, train in epochs, evaluate, checkpoint, end where values diverge.

The caller keeps control: it pulls events, and between two of them it may store, stop (by not asking for
more), or ask for a checkpoint of the current state.
"""

import math
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any, Generic

import jax
import numpy as np
from numpy.typing import NDArray

from core.algorithms.algorithm import OF_CLIPS, Algorithm, Failure, RunSettings, S
from core.algorithms.catalog import ALGORITHMS, loaded
from core.algorithms.compiled_functions import CompiledFunctions, in_phases, place, trace
from core.algorithms.events import (
    BodyLost,
    CheckpointReady,
    Evaluated,
    Evaluating,
    Event,
    Phase,
    TrainingProgress,
)
from core.algorithms.hosts import Hosts
from core.algorithms.profiling import UpdateTimes, update_times
from core.algorithms.spec import BaseSpec
from core.environments.environment import Environment
from core.errors import JobFailed
from core.reasons import Reason

# Commands to the processes on other hosts, besides the number of updates at which the next epoch ends.
_GATHER, _END = "gather", "end"


def make_run(  # noqa: PLR0913 - all of them are named
    environment: Environment,
    settings: BaseSpec,
    *,
    seed: int,
    checkpoint_every_steps: int | None,
    resume: bytes | None = None,
    devices: int = 1,
    epoch_s: float = 1.0,
    experts: Sequence[Any] = (),
    new_clips: bool = False,
) -> "Run[Any]":
    """A run of the algorithm that the settings belong to.

    environment: one environment; the algorithm steps copies of it side by side. settings: resolved, see
    `core.algorithms.catalog.resolve`. seed: not used if the run resumes. devices: how many of JAX's devices
    share the run, those of other hosts included; the result differs only by rounding. experts: of a
    distillation, the `TrainedPolicy` of each. For the others see `Run`.

    Raises Rejected where the settings, the environment or the devices do not go together;
    JobFailed("bad_model") where the environment lacks what they need; and whatever `Run` raises.
    """
    algorithm = loaded(ALGORITHMS[settings.algorithm()].algorithm)(
        environment, settings, seed=seed, devices=devices, **({"experts": experts} if experts else {})
    )
    return Run(
        algorithm,
        checkpoint_every_steps=checkpoint_every_steps,
        resume=resume,
        epoch_s=epoch_s,
        new_clips=new_clips,
    )


def about_clips(state: Any) -> dict[str, Any]:
    """The fields of a state that begin again where a run resumes with other clips."""
    return {field.name: getattr(state, field.name) for field in fields(state) if field.name in OF_CLIPS}


def begun_after(before: Any, begun: S) -> S:
    """The first state of a run. before: of a run with other clips, from which it resumes; None: of none."""
    return begun if before is None else replace(before, **about_clips(begun))


class Run(Generic[S]):
    """A run from its beginning, or from a checkpoint, to the end of its budget.

    checkpoint_every_steps: environment steps, over all environments, between CheckpointReady events; the last
    is always at the end. resume: a checkpoint; the run resumes from it, with its random keys. epoch_s: an
    epoch's target duration in seconds; it only changes how often Progress comes. new_clips: the checkpoint is
    of a run with other clips: episodes begin again in these, and so does what is kept of them (`OF_CLIPS`).

    Raises JobFailed("bad_checkpoint") when `resume` is damaged or belongs to a run of another shape.
    """

    def __init__(
        self,
        algorithm: Algorithm[S],
        *,
        checkpoint_every_steps: int | None,
        resume: bytes | None = None,
        epoch_s: float = 1.0,
        new_clips: bool = False,
    ) -> None:
        self._algorithm = algorithm
        self._hosts = Hosts()
        everywhere = algorithm.sharding.of_axes()
        self._seed = algorithm.sharding.put(algorithm.seed, everywhere)
        self._hyperparameters = algorithm.sharding.put(algorithm.hyperparameters, everywhere)
        self._loop = TrainingLoop.of(algorithm.settings, checkpoint_every_steps, epoch_s)
        self._state: S | None = None
        self._learnt_before: S | None = None
        self._functions: CompiledFunctions[S] | None = None
        self._lost: BodyLost | None = None
        self._has_told_lost = False
        self._resumed_from = resume if algorithm.sharding.has_other_hosts and not new_clips else None
        if resume is not None:
            self._restore(resume, new_clips=new_clips)

    @property
    def step(self) -> int:
        """Environment steps taken so far, over all environments, those before a resumption included."""
        return self._loop.step

    @property
    def total(self) -> int:
        """Environment steps at the end of the run: the budget, rounded up to whole updates."""
        return self._loop.total

    def events(self) -> Generator[Event]:
        """Train to the end of the budget: Phase trace and compile, then the events of `Loop.events`, and
        BodyLost before the first one after that.

        Raises JobFailed("diverged") at a value that is not finite; `checkpoint()` is then the state before
        the update that gave it; after a bad evaluation, the state that was evaluated.
        """
        functions, phases = self._prepare()
        yield from phases
        try:
            for event in self._loop.events(
                partial(self._train, functions), partial(self._evaluate, functions)
            ):
                yield from self._newly_lost()
                yield event
        except JobFailed:
            yield from self._newly_lost()
            raise

    def follow(self) -> None:
        """Take part, on another host, in the run of the process that pulls `events`, until that calls `end`.

        Nothing else of this run may be used.
        """
        functions, _ = self._prepare()
        while (command := self._hosts.next_command()) != _END:
            if command == _GATHER:
                jax.block_until_ready(functions.whole(self._begun))
            else:
                self._state = functions.epoch(self._begun, self._hyperparameters, np.int32(command))[0]
                jax.block_until_ready(self._state.num_updates)

    def end(self) -> None:
        """Let the processes on other hosts end, which follow this run; it can then do nothing more."""
        self._hosts.tell(_END)

    def evaluate(self, seed: int) -> dict[str, float]:
        """The metrics of episodes with other starts than the run's own evaluations have.

        Valid after the first event of training; the run goes on as if it had not been called.
        """
        state = self._begun
        if self._functions is None:
            raise RuntimeError("The run has no compiled functions before its first event.")
        key = jax.random.fold_in(jax.device_get(state.eval_key), seed)
        totals = self._functions.evaluate(self._algorithm.evaluated(state), key, state.num_updates)
        return self._algorithm.after_evaluation(state, jax.device_get(totals))[1]

    def update_times(self, environment: Environment) -> UpdateTimes | None:
        """The time that parts of the next update take; see `core.algorithms.profiling`.

        environment: that of the run. Valid as `evaluate`.
        """
        return update_times(self._algorithm, self._begun, self._hyperparameters, environment)

    def checkpoint(self) -> bytes:
        """The whole state of the run: equal states give equal bytes.

        Valid between two events; in a run that resumes with the same clips, also before the first.
        """
        state = self._begun
        if self._algorithm.sharding.has_other_hosts:
            if self._functions is None:
                return self._resumed_from or b""  # The other hosts are not there yet.
            self._hosts.tell(_GATHER)
            state = self._functions.whole(state)
        return self._algorithm.format.pack(self._algorithm.header, self._loop.progress, state)

    def policy(self) -> bytes:
        """The parameters that inference needs, in the algorithm's own file format."""
        return self._algorithm.policy(self._begun)

    def tables(self) -> Mapping[str, NDArray[Any]]:
        """Arrays to store beside the policy, with pictures: see `Algorithm.tables`."""
        return self._algorithm.tables(self._begun)

    @property
    def _begun(self) -> S:
        if self._state is None:
            raise RuntimeError("The run has no state before its first event.")
        return self._state

    def _restore(self, content: bytes, *, new_clips: bool) -> None:
        algorithm = self._algorithm
        template: Any = jax.eval_shape(algorithm.init, algorithm.seed)
        unread = about_clips(template) if new_clips else {}
        template = replace(template, **dict.fromkeys(unread))
        description = {**algorithm.description, "seeds": None}  # Those of a job of several seeds do not fit.
        progress, state = algorithm.format.unpack(content, description, template, tuple(unread))
        state = place(algorithm, state)
        if new_clips:
            self._learnt_before = state
        else:
            self._state = state
        self._loop.resume(progress)

    def _prepare(self) -> tuple[CompiledFunctions[S], Sequence[Phase]]:
        """Compile, and begin unless the run resumes."""
        self._functions, phases = in_phases(partial(trace, self._algorithm))
        self._hosts.meet("compiled")
        if self._state is None:
            self._state = begun_after(self._learnt_before, self._functions.init(self._seed))
            self._learnt_before = None
        return self._functions, phases

    def _train(self, functions: CompiledFunctions[S], until: int) -> dict[str, float]:
        """Train up to `until` updates; the metrics of the epoch."""
        self._hosts.tell(str(until))
        state, sums, failure = functions.epoch(self._begun, self._hyperparameters, np.int32(until))
        self._state = state
        failure = jax.device_get(failure)
        before, self._loop.updates = self._loop.updates, int(state.num_updates)
        self._see(failure)
        if failure.quantities.any():
            raise diverged(self._algorithm, failure, self.step)
        return self._algorithm.training_metrics(state, jax.device_get(sums), self._loop.updates - before)

    def _see(self, failure: Failure) -> None:
        """Remember the first body that the run has lost. failure: on the host."""
        lost, algorithm = failure.lost, self._algorithm
        if self._lost is None and lost is not None and lost.found:
            per_update = algorithm.settings.env_steps_per_update
            self._lost = BodyLost.of(lost, per_update, algorithm.env_steps_per_time_step)

    def _newly_lost(self) -> Generator[Event]:
        if self._lost is not None and not self._has_told_lost:
            self._has_told_lost = True
            yield self._lost

    def _evaluate(self, functions: CompiledFunctions[S]) -> dict[str, float]:
        state = self._begun
        totals = functions.evaluate(self._algorithm.evaluated(state), state.eval_key, state.num_updates)
        self._state, metrics = self._algorithm.after_evaluation(state, jax.device_get(totals))
        return metrics


@dataclass(frozen=True)
class Schedule:
    """After which of a run's `num_updates` updates an evaluation or a checkpoint is due.

    num_evals: evaluations spread evenly, the last at the end. checkpoint_every_steps: environment steps
    between checkpoints, each at the first update that reaches its multiple; None: only at the end.
    """

    num_updates: int
    steps_per_update: int
    num_evals: int
    checkpoint_every_steps: int | None

    def evaluation_due(self, update: int) -> bool:
        """Whether the policy is evaluated after this many updates."""
        return self._evaluations(update) > self._evaluations(update - 1)

    def checkpoint_due(self, update: int) -> bool:
        """Whether a checkpoint is made after this many updates."""
        return update >= self.num_updates or self._checkpoints(update) > self._checkpoints(update - 1)

    def next_stop(self, update: int) -> int:
        """The first update after this one at which something is due."""
        stop = self.num_updates
        if self.num_evals:
            stop = min(stop, -(-(self._evaluations(update) + 1) * self.num_updates // self.num_evals))
        if self.checkpoint_every_steps is not None:
            step = (self._checkpoints(update) + 1) * self.checkpoint_every_steps
            stop = min(stop, -(-step // self.steps_per_update))
        return stop

    def _evaluations(self, update: int) -> int:
        return update * self.num_evals // self.num_updates

    def _checkpoints(self, update: int) -> int:
        return (
            update * self.steps_per_update // self.checkpoint_every_steps
            if self.checkpoint_every_steps
            else 0
        )


class TrainingLoop:
    """Counts a run's updates, and decides what is due when.

    epoch_s: an epoch's target duration in seconds; it only changes how often Progress comes.
    """

    def __init__(self, schedule: Schedule, epoch_s: float) -> None:
        self.updates = 0
        self._evaluated = 0
        self._schedule = schedule
        self._epoch_s = epoch_s
        self._training_s = self._evaluation_s = 0.0

    @classmethod
    def of(cls, settings: RunSettings, checkpoint_every_steps: int | None, epoch_s: float) -> "TrainingLoop":
        """The loop of a run under these settings."""
        schedule = Schedule(
            settings.num_updates, settings.env_steps_per_update, settings.num_evals, checkpoint_every_steps
        )
        return cls(schedule, epoch_s)

    @property
    def step(self) -> int:
        """Environment steps taken so far, those before a resumption included."""
        return self.updates * self._schedule.steps_per_update

    @property
    def total(self) -> int:
        """Environment steps at the end: the budget, rounded up to whole updates."""
        return self._schedule.num_updates * self._schedule.steps_per_update

    @property
    def progress(self) -> dict[str, int]:
        """The counters that a checkpoint keeps."""
        return {"step": self.step, "updates": self.updates, "evaluated": self._evaluated}

    def resume(self, progress: Mapping[str, int]) -> None:
        """Continue from the counters that a checkpoint kept."""
        self.updates, self._evaluated = progress["updates"], progress["evaluated"]

    def events(
        self, train: Callable[[int], Mapping[str, float]], evaluate: Callable[[], dict[str, float]]
    ) -> Iterator[Event]:
        """Yields Progress for each epoch, and when due Evaluating, Evaluated and CheckpointReady; the last
        at the end in any case. Phase first_update precedes the first Progress.

        train: trains until the given number of updates is made or a value is not finite, records the number
        in `updates`, and returns the epoch's metrics. evaluate: the metrics of the current state.
        Raises JobFailed("diverged") if an evaluation's metric is not finite.
        """
        yield from self._evaluate_if_due(evaluate)  # a run may be stopped before an evaluation that was due
        if self.updates >= self._schedule.num_updates:
            yield CheckpointReady(self.step)
        until = self.updates + 1
        while self.updates < self._schedule.num_updates:
            before, first = self.updates, not self._training_s
            started = time.perf_counter()
            metrics = train(until)
            seconds, updates = time.perf_counter() - started, self.updates - before
            self._training_s += seconds
            if first:
                yield Phase("first_update", seconds)
            yield TrainingProgress(
                self.step,
                self.total,
                {
                    "training/sps": updates * self._schedule.steps_per_update / seconds,
                    "training/walltime": self._training_s,
                    **metrics,
                },
            )
            yield from self._evaluate_if_due(evaluate)
            if self._schedule.checkpoint_due(self.updates):
                yield CheckpointReady(self.step)
            affordable = max(1, round(self._epoch_s * updates / seconds))
            until = min(self.updates + affordable, self._schedule.next_stop(self.updates))

    def _evaluate_if_due(self, evaluate: Callable[[], dict[str, float]]) -> Iterator[Event]:
        if self._evaluated == self.updates or not self._schedule.evaluation_due(self.updates):
            return
        yield Evaluating(self.step)
        started = time.perf_counter()
        metrics = evaluate()
        seconds = time.perf_counter() - started
        self._evaluation_s += seconds
        share = self._evaluation_s / (self._evaluation_s + self._training_s)
        metrics |= {
            "eval/epoch_eval_time": seconds,
            "eval/walltime": self._evaluation_s,
            "eval/walltime_share": share,
        }
        check_finite(metrics, self.step)
        self._evaluated = self.updates
        yield Evaluated(self.step, metrics)


def check_finite(evaluated: Mapping[str, float], step: int) -> None:
    """Raises JobFailed("diverged") if a metric of the evaluation at this environment step is not finite."""
    bad = [name for name, value in evaluated.items() if not math.isfinite(value)]
    if bad:
        raise JobFailed(
            Reason.DIVERGED,
            f"The evaluation at environment step {step} gave a value that is not finite: {bad[0]}.",
            step=step,
            quantity=bad[0],
        )


def diverged(algorithm: Algorithm[S], failure: Failure, step: int) -> JobFailed:
    """The error for a failure, on the host, in the update after the last good state. step: of that state."""
    quantity = algorithm.quantities[int(np.argmax(failure.quantities))]
    within = int(failure.time_step) * algorithm.env_steps_per_time_step
    at = step + min(within, algorithm.settings.env_steps_per_update)
    return JobFailed(
        Reason.DIVERGED,
        f"The {quantity} became non-finite at environment step {at}; the last good state is that of "
        f"step {step}.",
        step=at,
        quantity=quantity,
    )
