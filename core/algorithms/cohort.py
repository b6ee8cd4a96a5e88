"""Runs of one algorithm that differ only in seeds and run-time hyperparameters, trained together.

One program moves all of them: `jax.vmap` of the program of one, as PureJaxRL does (Lu et al., Discovered
Policy Optimisation, 2022). A member's result equals that of its own run except for rounding.
"""

from collections.abc import Generator, Iterator, Mapping, Sequence, Set
from dataclasses import replace
from functools import partial
from typing import Any, Generic

import jax
import jax.numpy as jnp
import numpy as np

from core.algorithms.algorithm import Algorithm, S
from core.algorithms.compiled_functions import CompiledFunctions, in_phases, trace_cohort
from core.algorithms.divergence import diverged
from core.algorithms.events import Evaluated, Event, Progress
from core.algorithms.loop import Loop, check_finite
from core.errors import JobFailed

# A member's number, with an event of its run or the failure that ended it.
Seen = tuple[int, Event | JobFailed]


class CohortRun(Generic[S]):
    """Runs from their beginnings to the end of their common budget.

    algorithms: of one kind, for equal environments and equal settings except those that change without
    compiling, each on one device. They must read no state in `training_metrics`, and change none in
    `after_evaluation`. checkpoint_every_steps, epoch_s: as in `Run`.
    """

    def __init__(
        self, algorithms: Sequence[Algorithm[S]], *, checkpoint_every_steps: int | None, epoch_s: float = 1.0
    ) -> None:
        self._algorithms = algorithms
        self._loop = Loop.of(algorithms[0].settings, checkpoint_every_steps, epoch_s)
        self._seeds = _stacked([one.seed for one in algorithms])
        self._hyperparameters = _stacked([one.hyperparameters for one in algorithms])
        self._updates = np.zeros(len(algorithms), int)
        self._live = set(range(len(algorithms)))
        self._state: S | None = None
        self._metrics: Mapping[int, Mapping[str, float]] = {}
        self._failed: dict[int, JobFailed] = {}

    @property
    def total(self) -> int:
        """Environment steps of each member at the end: the budget, rounded up to whole updates."""
        return self._loop.total

    @property
    def failed(self) -> Set[int]:
        """The members that have diverged."""
        return set(range(len(self._algorithms))) - self._live

    def step(self, member: int) -> int:
        """Environment steps that the member has taken; once it has failed, those of its last good state."""
        return int(self._updates[member]) * self._algorithms[0].settings.env_steps_per_update

    def moments(self) -> Iterator[Sequence[Seen]]:
        """The events of `Run.events`, each as every member sees it that has not failed; a member that
        diverges sees its failure once, and nothing afterwards. The others go on."""
        functions = yield from self._prepare()
        for event in self._loop.events(partial(self._train, functions), partial(self._evaluate, functions)):
            failed, self._failed = self._failed, {}
            self._live -= failed.keys()
            yield [
                *failed.items(),
                *((member, self._as_seen(event, member)) for member in sorted(self._live)),
            ]
            if not self._live:
                return

    def checkpoint(self, member: int) -> bytes:
        """The whole state of a member, as that of its own run; valid between two moments of training."""
        algorithm, updates = self._algorithms[member], int(self._updates[member])
        progress = {**self._loop.progress, "step": self.step(member), "updates": updates}
        progress["evaluated"] = min(progress["evaluated"], updates)
        return algorithm.format.pack(algorithm.header, progress, self._of(member))

    def policy(self, member: int) -> bytes:
        """The parameters that inference needs, in the algorithm's own file format."""
        return self._algorithms[member].policy(self._of(member))

    @property
    def _begun(self) -> S:
        if self._state is None:
            raise RuntimeError("The runs have no state before their first event.")
        return self._state

    def _of(self, member: int) -> S:
        return _row(member, self._begun)

    def _as_seen(self, event: Event, member: int) -> Event:
        if isinstance(event, Progress | Evaluated):
            return replace(event, metrics={**event.metrics, **self._metrics[member]})
        return event

    def _prepare(self) -> Generator[Sequence[Seen], None, CompiledFunctions[S]]:
        trace_all = partial(trace_cohort, self._algorithms[0], self._seeds, self._hyperparameters)
        functions, phases = in_phases(trace_all)
        self._state = functions.init(self._seeds)
        for phase in phases:
            yield [(member, phase) for member in sorted(self._live)]
        return functions

    def _train(self, functions: CompiledFunctions[S], until: int) -> dict[str, float]:
        """Train up to `until` updates; each member's metrics are kept for the event that follows."""
        before = self._updates
        self._state, sums, failure = functions.epoch(self._begun, self._hyperparameters, np.int32(until))
        sums, failure, self._updates = jax.device_get((sums, failure, self._state.num_updates))
        self._metrics = {}
        for member in self._live:
            algorithm, own = self._algorithms[member], partial(_row, member)
            if failure.quantities[member].any():
                self._failed[member] = diverged(algorithm, own(failure), self.step(member))
                continue
            updates = int(self._updates[member] - before[member])
            self._metrics[member] = algorithm.training_metrics(self._state, own(sums), updates)
        self._loop.updates = int(max(self._updates[member] for member in self._live))
        return {}

    def _evaluate(self, functions: CompiledFunctions[S]) -> dict[str, float]:
        """Evaluate all; each member's metrics are kept for the event that follows."""
        state = self._begun
        evaluated = self._algorithms[0].evaluated(state)
        totals = jax.device_get(functions.evaluate(evaluated, state.eval_key, state.num_updates))
        self._metrics = {
            member: self._algorithms[member].after_evaluation(state, _row(member, totals))[1]
            for member in self._live
        }
        for member, metrics in self._metrics.items():
            try:
                check_finite(metrics, self.step(member))
            except JobFailed as failure:
                self._failed[member] = failure
        return {}


def _stacked(trees: Sequence[Any]) -> Any:
    return jax.tree.map(lambda *arrays: jnp.stack(arrays), *trees)


def _row(member: int, tree: Any) -> Any:
    return jax.tree.map(lambda x: x[member], tree)
