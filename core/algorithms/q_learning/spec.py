"""Tabular Q-learning's hyperparameters, and its choices of state discretizers and action sets."""

import math
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from core.algorithms.spec import BaseSpec, EpsilonSchedule, NumEvals, Share
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


class EpisodicEpsilonSchedule(EpsilonSchedule):
    """The share of choices that are made at random: from `start` to `end`, and then it stays."""

    decay_episodes: int | None = Field(
        default=None,
        ge=1,
        le=10**9,
        description="Episodes until `end`, in place of `decay_decisions`; constant within an episode.",
    )


class ReplaySpec(Strict):
    """Past transitions, to learn from again."""

    buffer_size: int = Field(default=10_000, ge=1, le=10**7, description="The newest so many are kept.")
    batch_size: int = Field(default=64, ge=1, le=10**6, description="Drawn after each decision.")


class AgentSpec(Strict):
    """One of several learners with a table of its own; what it leaves out is what the algorithm says."""

    seed: int | None = Field(
        default=None, ge=0, le=2**31 - 1, description="By default the job's, plus the agent's number."
    )
    learning_rate: Share | None = None
    discounting: Share | None = None
    epsilon_start: Share | None = None
    epsilon_end: Share | None = None


class QLearningSpec(BaseSpec):
    """Tabular Q-learning (Watkins & Dayan, 1992).

    A field that is not given takes the value tuned for the environment and the device, if there is one,
    and otherwise the default shown here; `GET /environments/{id}` shows the result.
    """

    why_no_seeds: ClassVar[str | None] = (
        "its `agents` learn side by side already, and each may have a `seed` of its own"
    )
    fixed_by_checkpoint: ClassVar[tuple[str, ...]] = (
        "num_agents",
        "env_steps_per_update",
        "decision_steps",
        "state_discretizer",
        "action_set",
        "replay_buffer_size",
    )

    kind: Literal["q_learning"] = "q_learning"
    state_discretizer: StateDiscretizerOptions | None = Field(
        default=None, description="How an observation becomes a row of the table."
    )
    action_set: ActionSetOptions | None = Field(
        default=None, description="How a column of the table becomes an action."
    )
    num_episodes: int = Field(
        default=100,
        ge=1,
        le=10**9,
        description="Episodes of each agent, rounded up to whole rounds: one in each of its environments.",
    )
    num_envs: int = Field(
        default=10, ge=1, le=MAX_ENVS, description="Environments of each agent, side by side."
    )
    decisions_per_episode: int = Field(
        default=50, ge=1, le=10**6, description="Decisions after which an episode is cut off."
    )
    decision_steps: int = Field(
        default=10,
        ge=1,
        le=10**4,
        description="Environment steps for which a choice is held; their rewards add up.",
    )
    learning_rate: float = Field(default=0.1, ge=0, le=1, description="0: nothing is learnt.")
    discounting: float = Field(default=0.99, ge=0, le=1, description="For each decision.")
    epsilon: EpisodicEpsilonSchedule = EpisodicEpsilonSchedule()
    world_updates: Literal["mean", "compound"] = Field(
        default="mean",
        description="How environments that visit the same cell at once change it. mean: one step towards the "
        "mean of their targets. compound: as far as one step of each, after another, would go: 1 - (1 - "
        "learning_rate)^n of the way.",
    )
    initial_table: Literal["constant", "random", "identity"] = Field(
        default="random",
        description="identity: 1 where row and column agree. With arms towards the target and leading arms "
        "that steers without any learning, which checks all the rest.",
    )
    initial_value: float = Field(
        default=0.0,
        ge=-1e6,
        le=1e6,
        description="Of every cell (constant), or of their middle (random); above what can be earned, the "
        "table is optimistic, and what is unknown is tried.",
    )
    initial_scale: float = Field(
        default=1e-3, gt=0, le=1e6, description="random: uniform up to so far from the middle."
    )
    replay: ReplaySpec | None = None
    agents: list[AgentSpec] = Field(
        default=[AgentSpec()], min_length=1, max_length=1024, description="Side by side in one program."
    )
    policy_agent: Literal["best", "first"] = Field(
        default="best", description="Whose table is the policy: best in the last evaluation, or the first's."
    )
    num_evals: NumEvals = 5
    num_eval_envs: int = Field(
        default=16, ge=1, le=2**16, description="Episodes of each agent in an evaluation, the same for all."
    )

    @property
    def num_agents(self) -> int:
        return len(self.agents)

    @property
    def replay_buffer_size(self) -> int:
        """0 where nothing is replayed."""
        return self.replay.buffer_size if self.replay else 0

    @property
    def num_parallel_envs(self) -> int:
        return self.num_agents * self.num_envs

    @property
    def num_updates(self) -> int:
        """Rounds: one episode in each environment."""
        return -(-self.num_episodes // self.num_envs)

    @property
    def env_steps_per_update(self) -> int:
        """Environment steps of one round, of all agents."""
        return self.num_parallel_envs * self.decisions_per_episode * self.decision_steps

    @property
    def budget(self) -> int:
        return self.num_updates * self.env_steps_per_update

    @property
    def num_decisions(self) -> int:
        """Decisions of one agent in the whole run."""
        return self.num_updates * self.num_envs * self.decisions_per_episode
