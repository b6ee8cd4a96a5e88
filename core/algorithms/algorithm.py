"""The part of a run that each algorithm defines; `core.algorithms.run.Run` does the rest."""

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol, TypeVar

import jax
from numpy.typing import NDArray

from core.algorithms.checkpoint import Format
from core.algorithms.evaluation import EpisodeTotals
from core.algorithms.lost_body import LostBody
from core.algorithms.sharding import Sharding


class TrainingState(Protocol):
    """Everything that a run's future depends on, besides its settings: a `flax.struct.dataclass` of arrays.

    num_updates: [] int32, updates made so far. eval_key: the random key of every evaluation, never changed.
    """

    @property
    def num_updates(self) -> jax.Array: ...

    @property
    def eval_key(self) -> jax.Array: ...


class Failure(NamedTuple):
    """Which of an algorithm's `quantities` were not finite in an update, and where.

    quantities: [len(quantities)] bool. time_step: [] int32, the first of the update's time steps at which one
    was not finite; the number of time steps if none was, or if it appeared after them. lost: the first body
    that the update lost; None of an algorithm that does not tell.
    """

    quantities: jax.Array
    time_step: jax.Array
    lost: LostBody | None = None


class RunSettings(Protocol):
    """The resolved hyperparameters that a run itself reads."""

    @property
    def num_updates(self) -> int: ...

    @property
    def env_steps_per_update(self) -> int: ...

    @property
    def num_evals(self) -> int: ...


S = TypeVar("S", bound=TrainingState)
# Fields of a training state that are about the clips of its environments: where these are, what is kept of
# what they did, one step after the other, and where they failed.
OF_CLIPS = ("episodes", "replay", "record")


class Algorithm(Protocol[S]):
    """An algorithm for one run: made from an environment, resolved settings, a seed and a number of devices.

    `init`, `update` and `evaluate` are pure and are compiled once; the other methods run on the host.
    `evaluated` is also called on shapes, so it may only select.
    Equal seeds give equal runs, bit for bit on a CPU.
    """

    @property
    def settings(self) -> RunSettings: ...

    @property
    def seed(self) -> Any:
        """The argument of `init`: arrays."""
        ...

    @property
    def hyperparameters(self) -> Any:
        """The second argument of `update`: arrays that may change without recompiling."""
        ...

    @property
    def quantities(self) -> tuple[str, ...]:
        """Names of the quantities checked after each update, in the order in which one spoils the next."""
        ...

    @property
    def env_steps_per_time_step(self) -> int:
        """How many environment steps, over all environments, one time step of an update takes."""
        ...

    @property
    def format(self) -> Format:
        """The format of its checkpoints; its name must be `gaitway-<kind>-<version>`."""
        ...

    @property
    def header(self) -> Mapping[str, Any]:
        """The facts that a checkpoint holds besides its state."""
        ...

    @property
    def description(self) -> Mapping[str, Any]:
        """The part of `header` that must be equal in a run that resumes."""
        ...

    @property
    def sharding(self) -> Sharding: ...

    @property
    def split_fields(self) -> tuple[str, ...]:
        """The state's fields whose first axis is environments, which devices share; the others are whole on
        every device."""
        ...

    def init(self, seed: Any, /) -> S:
        """The state before the first update."""
        ...

    def update(self, state: S, hyperparameters: Any, /) -> tuple[S, dict[str, jax.Array], Failure]:
        """The next state, with `num_updates` one higher; the update's metrics, always the same names, which
        an epoch adds up; and which quantities were not finite."""
        ...

    def evaluated(self, state: S) -> Any:
        """The part of a state that an evaluation needs."""
        ...

    def evaluate(self, evaluated: Any, key: jax.Array, update: jax.Array, /) -> EpisodeTotals:
        """Totals of the episodes that evaluate a policy. key: its state's eval_key; update: num_updates."""
        ...

    def training_metrics(self, state: S, sums: Mapping[str, Any], num_updates: int) -> dict[str, float]:
        """An epoch's metrics by Brax's names. state: after the epoch. sums: `update`'s metrics, summed over
        the epoch's `num_updates`, on the host.

        `training/episodes`, those so far, and `training/num_episodes`, those of the whole run, show as
        progress; `training/epsilon` asks for the plot of episodes.
        """
        ...

    def after_evaluation(self, state: S, totals: EpisodeTotals) -> tuple[S, dict[str, float]]:
        """The state after an evaluation, and its metrics by Brax's names; totals: on the host."""
        ...

    def policy(self, state: S) -> bytes:
        """The parameters that inference needs, in the algorithm's own file format."""
        ...

    def tables(self, state: S) -> Mapping[str, NDArray[Any]]:
        """Arrays to store beside the policy, with pictures; empty if the algorithm has none.

        `q_table` and `visits`, [states, actions] or [agents, states, actions], are drawn and labelled with
        the texts `state_names` [states] and `action_names` [actions]. Others are only stored.
        """
        ...
