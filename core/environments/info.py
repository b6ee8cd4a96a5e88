"""What is known of an environment without loading it: the API reads this and imports no numerical code."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from core.documents import Strict
from core.physics.availability import EngineName, Rule

Device = Literal["cpu", "gpu"]
OUR_FAMILY = "gaitway"


class NoOptions(Strict):
    """An environment that cannot be adjusted."""


@dataclass(frozen=True)
class EnvironmentInfo:
    """One row of the catalog.

    factory: `module:function`, called as `factory(options, engine_factory, **arguments)`; see `catalog.make`.
    observation_size, action_size: with default options. dt: seconds between actions. None where these
    depend on the model that the options name. takes_model: whether they name one; its file goes to the
    factory as `model`.
    cameras: the names the model gives its cameras, in their order; `track` is always there besides.
    info: what `State.info` names besides the observation, for who reads states from it. has_cpg: whether an
    action modulates a central pattern generator instead of joints. num_arms: the body's; 1 without any.
    alike_arms: whether all of them have as many joints.
    tuned: hyperparameters by algorithm and device, laid under what a job's specification says.
    arguments: what the factory is told besides. on_a_gpu: which engine `auto` takes on a GPU; the first rule
    that fits. cannot_run: engines that cannot run it, and why.
    package: what it loads that a worker may be without, by the name under which it is imported.
    own_physics: what moves it where none of the engines does; its worlds cannot differ.
    vary: the fields above that are others under some options, by name; the row itself has them as they are
    by default.
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
    options: type[Strict] = NoOptions
    arguments: Mapping[str, Any] = field(default_factory=dict[str, Any])
    takes_model: bool = False
    info: tuple[str, ...] = ()
    has_cpg: bool = False
    num_arms: int = 1
    alike_arms: bool = True
    tuned: Mapping[str, Mapping[Device, Mapping[str, Any]]] = field(default_factory=dict[str, Any])
    on_a_gpu: tuple[Rule, ...] = ()
    cannot_run: Mapping[EngineName, str] = field(default_factory=dict[EngineName, str])
    package: str | None = None
    own_physics: str = ""
    vary: Callable[[Any], Mapping[str, Any]] | None = None

    @property
    def family(self) -> str:
        """Whose it is: the package that the id begins with, or `gaitway`."""
        return self.id.split("/")[0] if "/" in self.id else OUR_FAMILY

    def under(self, options: Strict) -> "EnvironmentInfo":
        """The row as it is under these options, which are its own."""
        return self if self.vary is None else replace(self, **self.vary(options))
