"""The options that say how a state becomes a row of the table, and how a column becomes an action."""

import math
from typing import Annotated, Literal

from pydantic import Field

from core.documents import Strict
from core.environments.info import EnvironmentInfo, FiniteSpace
from core.environments.options import Range

# Such a table, its visits and a copy take 120 MB.
MAX_CELLS = 10_000_000
MAX_ENVS = 2**20
# Transitions of all agents' buffers: 2.4 GB.
MAX_REPLAYED = 10**8

Cells = Annotated[int, Field(ge=1, le=100_000)]
ActionVector = Annotated[list[Annotated[float, Field(ge=-1, le=1)]], Field(min_length=1, max_length=1000)]
Actions = Annotated[list[ActionVector], Field(min_length=1, max_length=10_000)]


class ArmTowardsTarget(Strict):
    """The arm in whose sector the target lies, seen from the disk: as many states as arms."""

    kind: Literal["arm_towards_target"]


class ArmRole(Strict):
    """Decentralised: each arm reads how many arms to its left the target's sector lies, 0 to arms - 1.

    All arms share one table, and each picks its own column.
    """

    kind: Literal["arm_role"]


class ArmSide(Strict):
    """Decentralised: each arm reads whether it is the closest to the target, on the left of the way there, on
    the right, or, in a star of an even number of arms, opposite. All arms share one table."""

    kind: Literal["arm_side"]


class DiskPositionGrid(Strict):
    """The cell of a grid in which the disk is; outside of the grid, the nearest one."""

    kind: Literal["disk_position_grid"]
    x: Range = Field(default=(-5.0, 5.0), description="Metres, in the world.")
    y: Range = Field(default=(-5.0, 5.0), description="Metres, in the world.")
    cells: list[Cells] = Field(
        default=[10, 10], min_length=2, max_length=2, description="How many along x, and along y."
    )

    @property
    def looks_at(self) -> str:
        return "disk_position"

    @property
    def num_states(self) -> int:
        return math.prod(self.cells)


class Component(Strict):
    """One component of the observation, cut into equal cells; outside of the range, the nearest one."""

    index: int = Field(ge=0, le=100_000)
    range: Range
    cells: Cells


class ObservationGrid(Strict):
    """The cell of a grid over components of the observation: for any environment."""

    kind: Literal["observation_grid"]
    components: list[Component] = Field(min_length=1, max_length=16)

    @property
    def looks_at(self) -> str:
        return "observation"

    @property
    def num_states(self) -> int:
        return math.prod(component.cells for component in self.components)

    def beyond(self, observation_size: int) -> dict[int, int]:
        """The components that an observation of this size lacks: their indices, by their places here."""
        return {
            place: component.index
            for place, component in enumerate(self.components)
            if component.index >= observation_size
        }


StateDiscretizerOptions = Annotated[
    ArmTowardsTarget | ArmRole | ArmSide | DiskPositionGrid | ObservationGrid, Field(discriminator="kind")
]


class LeadingArm(Strict):
    """A choice is the arm that leads; the central pattern generator of a brittle star does the rest."""

    kind: Literal["leading_arm"]


class ArmRoles(Strict):
    """A choice of each arm is its role in the central pattern generator: to lead, to row on the left or on
    the right, and, in a star of an even number of arms, to trail."""

    kind: Literal["arm_roles"]


class ArmAmplitudes(Strict):
    """A choice of each arm is the part of the gait's amplitude with which its oscillators move it: 0, a half
    or 1. All arms row in the same sense."""

    kind: Literal["arm_amplitudes"]


class ActionList(Strict):
    """A choice is one of these actions."""

    kind: Literal["actions"]
    actions: Actions = Field(description="Each as long as the environment's action.")


class ArmActions(Strict):
    """A choice of each arm is one of these parts of an action; the arms' parts follow one another."""

    kind: Literal["arm_actions"]
    actions: Actions = Field(description="Each as long as the environment's action divided by its arms.")


ActionSetOptions = Annotated[
    LeadingArm | ArmRoles | ArmAmplitudes | ActionList | ArmActions, Field(discriminator="kind")
]


def state_space(options: StateDiscretizerOptions, environment: EnvironmentInfo) -> FiniteSpace | None:
    """The states that the environment is in under these options; None where it does not offer them."""
    match options:
        case DiskPositionGrid() | ObservationGrid():
            return FiniteSpace(options.num_states)
        case ArmTowardsTarget() | ArmRole() | ArmSide():
            return environment.finite.state_discretizers.get(options.kind)


def choice_space(options: ActionSetOptions, environment: EnvironmentInfo) -> FiniteSpace | None:
    """The choices that there are under these options; None where the environment does not offer them."""
    match options:
        case ActionList():
            return FiniteSpace(len(options.actions))
        case ArmActions():
            parts = environment.finite.action_parts
            return FiniteSpace(len(options.actions), parts) if parts > 1 else None
        case LeadingArm() | ArmRoles() | ArmAmplitudes():
            return environment.finite.action_sets.get(options.kind)


def steers_a_generator(options: ActionSetOptions | None) -> bool:
    """Whether these choices, or those that a job leaves to the tuned values, set a pattern generator."""
    return options is None or isinstance(options, LeadingArm | ArmRoles | ArmAmplitudes)
