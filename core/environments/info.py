"""Facts on an environment, and the numbers of its observation and action by name.

They need no loading: the API reads them and imports no numerical code.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from core.documents import Strict
from core.errors import Problem
from core.physics.availability import EngineName, Rule


@dataclass(frozen=True)
class Slice:
    """A part of an observation, or of an action: `size` numbers from `start` on.

    name: the same for neighbouring slices of one array, each of which has one unit. unit: `1` for numbers
    without one; several, in the order of a row, where rows of different quantities repeat; None where it is
    not known. low, high: of an observation bounds that its values keep, up to rounding, or None; of an
    action, whose numbers lie in [-1, 1], what -1 and 1 set. components: a name for each number; empty where
    they are not known.
    """

    name: str
    start: int
    size: int
    unit: str | None = None
    low: float | None = None
    high: float | None = None
    components: tuple[str, ...] = ()


# The names of an environment's observations: of what its policy sees, and of what only a value function sees.
POLICY_GROUP, CRITIC_GROUP = "state", "privileged_state"


@dataclass(frozen=True)
class Spaces:
    """All slices of an environment's observation and of its action, in their order.

    critic: of the observation that only a value function sees; empty where there is none.
    """

    observation: tuple[Slice, ...] = ()
    action: tuple[Slice, ...] = ()
    critic: tuple[Slice, ...] = ()

    @property
    def observation_size(self) -> int:
        return sum(one.size for one in self.observation)

    @property
    def action_size(self) -> int:
        return sum(one.size for one in self.action)

    def group(self, name: str) -> tuple[Slice, ...]:
        """The slices of the observation of this name."""
        return self.critic if name == CRITIC_GROUP else self.observation


def named(
    name: str,
    components: Iterable[str],
    unit: str | None,
    low: float | None = None,
    high: float | None = None,
) -> Slice:
    """A slice whose place is not yet known."""
    names = tuple(components)
    return Slice(name, 0, len(names), unit, low, high, names)


def in_order(slices: Iterable[Slice]) -> tuple[Slice, ...]:
    """The slices one after the other; empty ones are left out."""
    placed: list[Slice] = []
    start = 0
    for one in slices:
        if one.size:
            placed.append(replace(one, start=start))
            start += one.size
    return tuple(placed)


Device = Literal["cpu", "gpu"]
OUR_FAMILY = "gaitway"


class NoOptions(Strict):
    """An environment that cannot be adjusted."""


@dataclass(frozen=True)
class FiniteSpace:
    """num_values: of each part. num_parts: parts of the body that read, or choose, for themselves, such as
    arms; 1: the whole body does."""

    num_values: int
    num_parts: int = 1


@dataclass(frozen=True)
class FiniteViews:
    """The sizes of the finite views that an environment offers: see `core.environments.environment`.

    action_parts: the parts of an action that are alike, such as arms with the same joints; 1 if it has none.
    cannot_offer: state discretizers and action sets of other rows, and why this one has them not.
    """

    state_discretizers: Mapping[str, FiniteSpace] = field(default_factory=dict[str, FiniteSpace])
    action_sets: Mapping[str, FiniteSpace] = field(default_factory=dict[str, FiniteSpace])
    action_parts: int = 1
    cannot_offer: Mapping[str, str] = field(default_factory=dict[str, str])


@dataclass(frozen=True)
class EnvironmentInfo:
    """One row of the catalog.

    factory: `module:function`, called as `factory(options, build_engine, **arguments)`; see `catalog.make`.
    observation_size, action_size: with default options. dt: seconds between actions. All three are None if
    they depend on the model that the options name. takes_model: whether they name one; the factory gets its
    file as `model`.
    cameras: the model's cameras, in their order; `track` is always available, too.
    observations: the names of its observations.
    info: the entries of `State.info` besides the observation, for code that reads states from it.
    finite: the finite views that it offers.
    arguments: further arguments of the factory. on_a_cpu, on_a_gpu: the engine that `auto` takes there, by
    the first rule that fits; `native` on a CPU and `mjx` on a GPU if none fits. cannot_run: engines that
    cannot run it, and why.
    decoders_of: the environment whose body it has, so that a decoder of its trainings fits; None: its own.
    package: what it imports that a worker may lack, by its import name.
    own_physics: what steps it if no engine does; its model cannot be randomized.
    has_curriculum: whether its fresh starts change while a run trains. curriculum_option: its place among
    the options.
    free_in_rollouts: options that a rollout may change from those that its policy was trained with.
    parts: the names of the model's parts that a task of terms may name, by kind (`bodies`, `joints`, `geoms`,
    `sensors`, `keyframes`); empty where they are not known.
    names: of all actuators, bodies, geoms and joints of the model, which rules of randomization name; empty
    where they are not known.
    vary: the fields above that some options change, by name; the row itself has their values under the
    default options. slices: the numbers of an observation and an action under these options; None where they
    are not known. chosen: the options that the row describes; None: the default ones. check: what is wrong
    with options that are valid each by itself. tuned: hyperparameters that a package has for its body, by
    algorithm and device; None: the body is ours, and algorithms know theirs.
    """

    id: str
    description: str
    factory: str
    observation_size: int | None
    action_size: int | None
    dt: float | None
    episode_length: int
    tracked_body: str
    cameras: tuple[str, ...] = ()
    observations: tuple[str, ...] = (POLICY_GROUP,)
    options: type[Strict] = NoOptions
    arguments: Mapping[str, Any] = field(default_factory=dict[str, Any])
    takes_model: bool = False
    info: tuple[str, ...] = ()
    finite: FiniteViews = FiniteViews()
    on_a_cpu: tuple[Rule, ...] = ()
    on_a_gpu: tuple[Rule, ...] = ()
    cannot_run: Mapping[EngineName, str] = field(default_factory=dict[EngineName, str])
    decoders_of: str | None = None
    package: str | None = None
    own_physics: str = ""
    has_curriculum: bool = False
    curriculum_option: str = "curriculum"
    free_in_rollouts: tuple[str, ...] = ()
    parts: Mapping[str, Sequence[str]] = field(default_factory=dict[str, Sequence[str]])
    names: Mapping[str, Sequence[str]] = field(default_factory=dict[str, Sequence[str]])
    vary: Callable[[Any], Mapping[str, Any]] | None = None
    slices: Callable[[Any], Spaces] | None = None
    chosen: Strict | None = None
    check: Callable[[Any], Sequence[Problem]] | None = None
    tuned: Mapping[str, Mapping[Device, Mapping[str, Any]]] | None = None

    @property
    def family(self) -> str:
        """The package that the id begins with, or `gaitway`."""
        return self.id.split("/")[0] if "/" in self.id else OUR_FAMILY

    def rules_on(self, device: Device) -> tuple[Rule, ...]:
        """How `auto` chooses the engine on this kind of device."""
        return self.on_a_cpu if device == "cpu" else self.on_a_gpu

    def under(self, options: Strict) -> "EnvironmentInfo":
        """The row under these options, which must be its own."""
        row = replace(self, chosen=options, **(self.vary(options) if self.vary else {}))
        if row.slices is None:
            return row
        spaces = row.spaces
        return replace(row, observation_size=spaces.observation_size, action_size=spaces.action_size)

    @property
    def spaces(self) -> Spaces:
        """The numbers of an observation and of an action; without names where these are not known."""
        if self.slices is not None:
            return self.slices(self.option_values)
        sizes = {"observation": self.observation_size, "action": self.action_size}
        return Spaces(**{name: (Slice(name, 0, size),) if size else () for name, size in sizes.items()})

    @property
    def option_values(self) -> Strict:
        """The options that the row describes. Raises ValidationError where it has no default ones."""
        return self.chosen or self.options.model_validate({})
