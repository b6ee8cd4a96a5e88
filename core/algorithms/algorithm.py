"""What one algorithm adds to a run: `core.algorithms.run.Run` does the rest."""

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol, TypeVar

import jax
from numpy.typing import NDArray

from core.algorithms.checkpoint import Format
from core.algorithms.evaluation import EpisodeTotals
from core.algorithms.sharding import Sharding


class TrainingState(Protocol):
    """Everything that a run's future depends on, besides its settings: a tree of arrays.

    num_updates: [] int32, updates made so far. eval_key: the evaluations' randomness, the same throughout.
    """

    @property
    def num_updates(self) -> jax.Array: ...

    @property
    def eval_key(self) -> jax.Array: ...


class Failure(NamedTuple):
    """Which of an algorithm's `quantities` were not finite in an update, and where.

    quantities: [len(quantities)] bool. time_step: [] int32, the first of the update's time steps at which one
    was not finite; the number of time steps if none was, or if it appeared after them.
    """

    quantities: jax.Array
    time_step: jax.Array


class RunSettings(Protocol):
    """What a run reads from an algorithm's resolved hyperparameters."""

    @property
    def num_updates(self) -> int: ...

    @property
    def env_steps_per_update(self) -> int: ...

    @property
    def num_evals(self) -> int: ...


S = TypeVar("S", bound=TrainingState)


class Algorithm(Protocol[S]):
    """Made from an environment, resolved settings, a seed and a number of devices.

    `init`, `update` and `evaluate` are pure and are compiled once; the other methods run on the host.
    Equal seeds give equal runs, bit for bit on a CPU.
    """

    @property
    def settings(self) -> RunSettings: ...

    @property
    def seed(self) -> Any:
        """What `init` takes: arrays."""
        ...

    @property
    def hyperparameters(self) -> Any:
        """What `update` takes besides the state: arrays that may change without compiling again."""
        ...

    @property
    def quantities(self) -> tuple[str, ...]:
        """Names of what is checked after each update, in the order in which one spoils the next."""
        ...

    @property
    def env_steps_per_time_step(self) -> int:
        """How many environment steps, over all environments, one time step of an update takes."""
        ...

    @property
    def format(self) -> Format:
        """Of its checkpoints."""
        ...

    @property
    def header(self) -> Mapping[str, Any]:
        """What a checkpoint says besides its state."""
        ...

    @property
    def description(self) -> Mapping[str, Any]:
        """What a checkpoint's header must agree on for this run to resume from it."""
        ...

    @property
    def sharding(self) -> Sharding: ...

    @property
    def split_fields(self) -> tuple[str, ...]:
        """The state's fields whose arrays lead with environments, which devices share; the others are whole
        on every device."""
        ...

    def init(self, seed: Any, /) -> S:
        """The state before the first update."""
        ...

    def update(self, state: S, hyperparameters: Any, /) -> tuple[S, dict[str, jax.Array], Failure]:
        """The next state, the update's metrics, and what in it was not finite."""
        ...

    def evaluated(self, state: S) -> Any:
        """The part of a state that an evaluation needs."""
        ...

    def evaluate(self, evaluated: Any, key: jax.Array, update: jax.Array, /) -> EpisodeTotals:
        """Totals of the episodes that try the policy after so many updates; key: the state's eval_key."""
        ...

    def training_metrics(self, state: S, sums: Mapping[str, Any], num_updates: int) -> dict[str, float]:
        """An epoch's metrics by Brax's names. state: after it. sums: of `update`'s metrics over the epoch's
        `num_updates`, on the host."""
        ...

    def after_evaluation(self, state: S, totals: EpisodeTotals) -> tuple[S, dict[str, float]]:
        """The state once it has been evaluated, and the metrics by Brax's names; totals: on the host."""
        ...

    def policy(self, state: S) -> bytes:
        """What inference needs, and nothing else, in the algorithm's own file format."""
        ...

    def tables(self, state: S) -> Mapping[str, NDArray[Any]]:
        """Arrays that are kept beside the policy, with pictures; empty where there are none to show.

        `q_table` and `visits`, [states, actions] or [agents, states, actions], are drawn; `state_names`
        [states] and `action_names` [actions], of text, are written beside them. Others are only kept.
        """
        ...
