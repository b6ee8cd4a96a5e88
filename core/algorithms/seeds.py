"""One run of several seeds, which one program trains together.

The program is `jax.vmap` of one seed's program, as in PureJaxRL (Lu et al., Discovered Policy Optimisation,
2022). A seed's result equals that of its own run except for rounding.
"""

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from statistics import fmean
from typing import Any, Generic, cast

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from core.algorithms.algorithm import Algorithm, Failure, S
from core.algorithms.catalog import ALGORITHMS, loaded
from core.algorithms.compiled_functions import CompiledFunctions, in_phases, trace_seeds
from core.algorithms.events import BodyLost, Event, SeedDiverged, metric_of_seed
from core.algorithms.run import TrainingLoop, about_clips, begun_after, check_finite, diverged
from core.algorithms.spec import BaseSpec
from core.environments.environment import Environment
from core.errors import JobFailed
from core.reasons import Reason


def make_seeds_run(  # noqa: PLR0913 - all of them are named
    environment: Environment,
    settings: BaseSpec,
    *,
    seeds: Sequence[int],
    checkpoint_every_steps: int | None,
    resume: bytes | None = None,
    epoch_s: float = 1.0,
    new_clips: bool = False,
) -> "SeedsRun[Any]":
    """Like `core.algorithms.run.make_run`, for several seeds on one device.

    Raises Rejected where the algorithm trains one seed at a time; see `BaseSpec.check_seeds`.
    """
    settings.check_seeds()
    algorithm = loaded(ALGORITHMS[settings.algorithm()].algorithm)
    algorithms = {seed: algorithm(environment, settings, seed=seed, devices=1) for seed in seeds}
    return SeedsRun(
        algorithms,
        checkpoint_every_steps=checkpoint_every_steps,
        resume=resume,
        epoch_s=epoch_s,
        new_clips=new_clips,
    )


class SeedsRun(Generic[S]):
    """Like `Run`, for several seeds: events, checkpoints and steps are common, policies are of a seed.

    A seed whose values become non-finite ends with its last good state, and the event SeedDiverged; the
    others continue. The run ends as diverged when no seed is left.

    algorithms: by seed, equal except for it, each for one device. They read no state in `training_metrics`,
    and change none in `after_evaluation`. The other arguments are those of `Run`.
    """

    def __init__(
        self,
        algorithms: Mapping[int, Algorithm[S]],
        *,
        checkpoint_every_steps: int | None,
        resume: bytes | None = None,
        epoch_s: float = 1.0,
        new_clips: bool = False,
    ) -> None:
        self._seeds = list(algorithms)
        self._algorithm = algorithm = algorithms[self._seeds[0]]
        self._keys = jax.tree.map(lambda *keys: jnp.stack(keys), *(one.seed for one in algorithms.values()))
        self._hyperparameters = jax.device_put(algorithm.hyperparameters)
        self._loop = TrainingLoop.of(algorithm.settings, checkpoint_every_steps, epoch_s)
        self._state: S | None = None
        self._learnt_before: S | None = None
        self._updates = np.zeros(len(self._seeds), np.int32)
        self._is_live = np.ones(len(self._seeds), bool)
        self._to_tell: list[Event] = []
        self._has_lost = False
        if resume is not None:
            self._restore(resume, new_clips=new_clips)

    @property
    def step(self) -> int:
        """Environment steps that each seed has taken that did not diverge."""
        return self._loop.step

    @property
    def total(self) -> int:
        """Environment steps of each seed at the end of the run: the budget, rounded up to whole updates."""
        return self._loop.total

    def step_of(self, seed: int) -> int:
        """Environment steps that the seed has taken; once it has diverged, those of its last good state."""
        return int(self._updates[self._seeds.index(seed)]) * self._algorithm.settings.env_steps_per_update

    def events(self) -> Generator[Event]:
        """The events of `Run.events`, and SeedDiverged.

        A metric's value is the mean over the seeds that have not diverged; each of their own values comes
        under the name that `metric_of_seed` gives.
        """
        functions, phases = in_phases(partial(trace_seeds, self._algorithm, self._keys))
        if self._state is None:
            self._state = begun_after(self._learnt_before, functions.init(self._keys))
            self._learnt_before = None
        yield from phases
        try:
            for event in self._loop.events(
                partial(self._train, functions), partial(self._evaluate, functions)
            ):
                yield from self._news()
                yield event
        except JobFailed:
            yield from self._news()
            raise

    def checkpoint(self) -> bytes:
        """The whole state of all seeds: equal states give equal bytes. Valid as that of `Run`."""
        algorithm, state = self._algorithm, {"runs": self._begun, "is_live": self._is_live}
        return algorithm.format.pack({**algorithm.header, "seeds": self._seeds}, self._loop.progress, state)

    def policy(self, seed: int) -> bytes:
        """The parameters that inference needs, in the algorithm's own file format."""
        return self._algorithm.policy(cast("S", _OneOf(self._begun, self._seeds.index(seed))))

    def tables(self) -> Mapping[str, NDArray[Any]]:
        """No algorithm that trains several seeds has any."""
        return {}

    @property
    def _begun(self) -> S:
        if self._state is None:
            raise RuntimeError("The run has no state before its first event.")
        return self._state

    def _restore(self, content: bytes, *, new_clips: bool) -> None:
        algorithm, is_live = self._algorithm, jax.ShapeDtypeStruct(self._is_live.shape, bool)
        runs: Any = jax.eval_shape(jax.vmap(algorithm.init), self._keys)
        unread = about_clips(runs) if new_clips else {}
        template = {"runs": replace(runs, **dict.fromkeys(unread)), "is_live": is_live}
        description = {**algorithm.description, "seeds": self._seeds}
        progress, saved = algorithm.format.unpack(content, description, template, tuple(unread))
        state, self._is_live = jax.tree.map(jnp.asarray, saved["runs"]), np.array(saved["is_live"])
        if new_clips:
            self._learnt_before = state
        else:
            self._state = state
        self._updates = np.array(saved["runs"].num_updates)
        self._loop.resume(progress)
        if not self._is_live.any():
            raise JobFailed(Reason.DIVERGED, "Every seed of the checkpoint has diverged.", step=self.step)

    def _train(self, functions: CompiledFunctions[S], until: int) -> dict[str, float]:
        """Train up to `until` updates those that have not diverged; the metrics of the epoch."""
        before = self._loop.updates
        wanted = np.where(self._is_live, until, self._updates).astype(np.int32)
        self._state, sums, failure = functions.epoch(self._begun, self._hyperparameters, wanted)
        sums, failure, self._updates = jax.device_get((sums, failure, self._state.num_updates))
        self._see(failure)

        def metrics_of(row: int) -> dict[str, float]:
            if failure.quantities[row].any():
                step = self.step_of(self._seeds[row])
                raise diverged(self._algorithm, _row(row, failure), step)
            updates = int(self._updates[row]) - before
            return self._algorithm.training_metrics(self._begun, _row(row, sums), updates)

        try:
            return self._metrics(metrics_of)
        finally:
            self._loop.updates = int(self._updates.max())

    def _see(self, failure: Failure) -> None:
        """Tell of the first body that a seed has lost, once. failure: on the host."""
        lost, algorithm = failure.lost, self._algorithm
        if lost is None or self._has_lost or not (rows := np.flatnonzero(lost.found & self._is_live)).size:
            return
        row, self._has_lost = int(rows[0]), True
        per_update, per_step = algorithm.settings.env_steps_per_update, algorithm.env_steps_per_time_step
        self._to_tell.append(BodyLost.of(_row(row, lost), per_update, per_step, self._seeds[row]))

    def _evaluate(self, functions: CompiledFunctions[S]) -> dict[str, float]:
        state = self._begun
        evaluated = self._algorithm.evaluated(state)
        totals = jax.device_get(functions.evaluate(evaluated, state.eval_key, state.num_updates))

        def metrics_of(row: int) -> dict[str, float]:
            metrics = self._algorithm.after_evaluation(state, _row(row, totals))[1]
            check_finite(metrics, self.step)
            return metrics

        return self._metrics(metrics_of)

    def _metrics(self, metrics_of: Callable[[int], dict[str, float]]) -> dict[str, float]:
        """The metrics of all seeds that have not diverged; one for which this raises JobFailed has now.

        metrics_of: those of a row. Raises JobFailed where none is left.
        """
        by_seed: dict[int, dict[str, float]] = {}
        for row in np.flatnonzero(self._is_live):
            seed = self._seeds[row]
            try:
                by_seed[seed] = metrics_of(int(row))
            except JobFailed as failed:
                self._is_live[row] = False
                facts: dict[str, Any] = {**failed.facts}
                self._to_tell.append(SeedDiverged(seed, facts["step"], facts["quantity"], failed.detail))
        if not by_seed:
            last = cast("SeedDiverged", self._to_tell[-1])
            detail = f"Every seed has diverged, seed {last.seed} as the last: {last.detail}"
            raise JobFailed(Reason.DIVERGED, detail, step=last.step, quantity=last.quantity)
        names = dict.fromkeys(name for metrics in by_seed.values() for name in metrics)
        means = {
            name: fmean(metrics[name] for metrics in by_seed.values() if name in metrics) for name in names
        }
        return means | {
            metric_of_seed(seed, name): value
            for seed, metrics in by_seed.items()
            for name, value in metrics.items()
        }

    def _news(self) -> Sequence[Event]:
        newly, self._to_tell = self._to_tell, []
        return newly


class _OneOf:
    """A state's fields for one seed, each made when it is read: a replay buffer is large."""

    def __init__(self, state: Any, row: int) -> None:
        self._state, self._at = state, row

    def __getattr__(self, name: str) -> Any:
        return _row(self._at, getattr(self._state, name))


def _row(row: int, tree: Any) -> Any:
    return jax.tree.map(lambda x: x[row], tree)
