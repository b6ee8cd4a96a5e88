"""One run of any algorithm: begin or resume, train, evaluate, checkpoint.

The caller keeps control: it pulls events, and between two of them it may store, stop (by not asking for
more), or ask for a checkpoint of the current state.
"""

from collections.abc import Generator, Mapping
from functools import partial
from typing import Any, Generic

import jax
import numpy as np
from numpy.typing import NDArray

from core.algorithms.algorithm import Algorithm, S
from core.algorithms.catalog import ALGORITHMS, loaded
from core.algorithms.compiled_functions import CompiledFunctions, in_phases, place, trace
from core.algorithms.divergence import diverged
from core.algorithms.events import Event
from core.algorithms.loop import Loop
from core.algorithms.profiling import UpdateTimes, update_times
from core.algorithms.spec import BaseSpec
from core.environments.environment import Environment


def make_run(  # noqa: PLR0913 - all of them are named
    environment: Environment,
    settings: BaseSpec,
    *,
    seed: int,
    checkpoint_every_steps: int | None,
    resume: bytes | None = None,
    devices: int = 1,
    epoch_s: float = 1.0,
) -> "Run[Any]":
    """A run of the algorithm that the settings belong to.

    environment: one environment; the algorithm steps copies of it side by side. settings: resolved, see
    `core.algorithms.catalog.resolve`. seed: not used if the run resumes. devices: how many of JAX's devices
    share the run; the result differs only by rounding. For the others see `Run`.

    Raises Rejected where the settings, the environment or the devices do not go together;
    JobFailed("bad_model") where the environment lacks what they need; and whatever `Run` raises.
    """
    algorithm = loaded(ALGORITHMS[settings.algorithm()].algorithm)(
        environment, settings, seed=seed, devices=devices
    )
    return Run(algorithm, checkpoint_every_steps=checkpoint_every_steps, resume=resume, epoch_s=epoch_s)


class Run(Generic[S]):
    """A run from its beginning, or from a checkpoint, to the end of its budget.

    checkpoint_every_steps: environment steps, over all environments, between CheckpointReady events; the last
    is always at the end. resume: a checkpoint; the run resumes from it, with its random keys. epoch_s: an
    epoch's target duration in seconds; it only changes how often Progress comes.

    Raises JobFailed("bad_checkpoint") when `resume` is damaged or belongs to a run of another shape.
    """

    def __init__(
        self,
        algorithm: Algorithm[S],
        *,
        checkpoint_every_steps: int | None,
        resume: bytes | None = None,
        epoch_s: float = 1.0,
    ) -> None:
        self._algorithm = algorithm
        self._hyperparameters = jax.device_put(algorithm.hyperparameters, algorithm.sharding.of_axes())
        self._loop = Loop.of(algorithm.settings, checkpoint_every_steps, epoch_s)
        self._state: S | None = None
        self._functions: CompiledFunctions[S] | None = None
        if resume is not None:
            self._restore(resume)

    @property
    def step(self) -> int:
        """Environment steps taken so far, over all environments, those before a resumption included."""
        return self._loop.step

    @property
    def total(self) -> int:
        """Environment steps at the end of the run: the budget, rounded up to whole updates."""
        return self._loop.total

    def events(self) -> Generator[Event]:
        """Train to the end of the budget: Phase trace and compile, then the events of `Loop.events`.

        Raises JobFailed("diverged") at a value that is not finite; `checkpoint()` is then the state before
        the update that gave it; after a bad evaluation, the state that was evaluated.
        """
        self._functions = functions = yield from self._prepare()
        yield from self._loop.events(partial(self._train, functions), partial(self._evaluate, functions))

    def evaluate(self, seed: int) -> dict[str, float]:
        """The metrics of episodes with other starts than the run's own evaluations have.

        Valid after the first event of training; the run goes on as if it had not been called.
        """
        state = self._begun
        if self._functions is None:
            raise RuntimeError("The run has no compiled functions before its first event.")
        key = jax.random.fold_in(state.eval_key, seed)
        totals = self._functions.evaluate(self._algorithm.evaluated(state), key, state.num_updates)
        return self._algorithm.after_evaluation(state, jax.device_get(totals))[1]

    def update_times(self, environment: Environment) -> UpdateTimes | None:
        """The time that parts of the next update take; see `core.algorithms.profiling`.

        environment: that of the run. Valid as `evaluate`.
        """
        return update_times(self._algorithm, self._begun, self._hyperparameters, environment)

    def checkpoint(self) -> bytes:
        """The whole state of the run: equal states give equal bytes.

        Valid between two events; in a run that resumes, also before the first.
        """
        return self._algorithm.format.pack(self._algorithm.header, self._loop.progress, self._begun)

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

    def _restore(self, content: bytes) -> None:
        algorithm = self._algorithm
        template = jax.eval_shape(algorithm.init, algorithm.seed)
        description = {**algorithm.description, "seeds": None}  # Those of a job of several seeds do not fit.
        progress, state = algorithm.format.unpack(content, description, template)
        self._state = place(algorithm, state)
        self._loop.resume(progress)

    def _prepare(self) -> Generator[Event, None, CompiledFunctions[S]]:
        functions, phases = in_phases(partial(trace, self._algorithm))
        if self._state is None:
            self._state = functions.init(self._algorithm.seed)
        yield from phases
        return functions

    def _train(self, functions: CompiledFunctions[S], until: int) -> dict[str, float]:
        """Train up to `until` updates; the metrics of the epoch."""
        state, sums, failure = functions.epoch(self._begun, self._hyperparameters, np.int32(until))
        self._state = state
        failure = jax.device_get(failure)
        before, self._loop.updates = self._loop.updates, int(state.num_updates)
        if failure.quantities.any():
            raise diverged(self._algorithm, failure, self.step)
        return self._algorithm.training_metrics(state, jax.device_get(sums), self._loop.updates - before)

    def _evaluate(self, functions: CompiledFunctions[S]) -> dict[str, float]:
        state = self._begun
        totals = functions.evaluate(self._algorithm.evaluated(state), state.eval_key, state.num_updates)
        self._state, metrics = self._algorithm.after_evaluation(state, jax.device_get(totals))
        return metrics
