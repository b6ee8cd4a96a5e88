"""Tabular Q-learning's hyperparameters, and which of them go together."""

from typing import Annotated, ClassVar, Literal

from pydantic import AliasChoices, Field

from core.algorithms.memory import Memory
from core.algorithms.q_learning import memory
from core.algorithms.q_learning.options import (
    MAX_CELLS,
    MAX_ENVS,
    MAX_REPLAYED,
    ActionList,
    ActionSetOptions,
    ArmActions,
    DiskPositionGrid,
    ObservationGrid,
    StateDiscretizerOptions,
    choice_space,
    state_space,
)
from core.algorithms.spec import BaseSpec
from core.documents import Strict
from core.environments.info import Device, EnvironmentInfo
from core.errors import Problem, Rejected

Share = Annotated[float, Field(ge=0, le=1)]


class EpsilonSchedule(Strict):
    """The share of choices that are made at random: from `start` to `end`, and then it stays."""

    start: Share = 0.5
    end: Share = 0.05
    decay_episodes: int | None = Field(
        default=None, ge=1, le=10**9, description="Episodes until `end`; constant within an episode."
    )
    decay_decisions: int | None = Field(
        default=None,
        ge=1,
        le=10**12,
        description="Decisions of an agent until `end`, those in all of its environments. Without "
        "either: all of the run's.",
    )
    shape: Literal["linear", "exponential"] = "linear"


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
        default=None,
        validation_alias=AliasChoices("state_discretizer", "indexer"),
        description="How what is seen becomes a row of the table. (`indexer`, its name until version 0.2, is "
        "deprecated and still accepted.)",
    )
    action_set: ActionSetOptions | None = Field(
        default=None,
        validation_alias=AliasChoices("action_set", "mapper"),
        description="How a column of the table becomes an action. (`mapper`, its name until version 0.2, is "
        "deprecated and still accepted.)",
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
    epsilon: EpsilonSchedule = EpsilonSchedule()
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
    num_evals: int = Field(
        default=5, ge=0, le=10_000, description="Evaluations, spread evenly; the last is at the end."
    )
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

    def refusal(self, environment: EnvironmentInfo, device: Device) -> Rejected | None:
        problems = [
            *_of_the_table(self, environment),
            *_of_the_schedule(self),
            *_of_the_envs(self),
            *_of_the_replay(self, environment),
        ]
        if not problems:
            return None
        return Rejected(" ".join(dict.fromkeys(problem.detail for problem in problems)), problems)

    def least_memory(self, environment: EnvironmentInfo, num_devices: int) -> Memory:
        return memory.least_memory(self, environment)


def _of_the_table(settings: QLearningSpec, environment: EnvironmentInfo) -> list[Problem]:
    """Whether these and the environment go together, as far as its row tells."""
    discretizer, action_set = settings.state_discretizer, settings.action_set
    problems = [
        *_of_the_states(discretizer, environment),
        *_of_the_actions(action_set, environment),
    ]
    if problems or discretizer is None or action_set is None:
        return problems
    states, choices = state_space(discretizer, environment), choice_space(action_set, environment)
    if states is None or choices is None:
        return problems
    if states.num_parts != choices.num_parts:
        detail = (
            f"The state discretizer {discretizer.kind!r} and the action set {action_set.kind!r} do not go "
            f"together: {discretizer.kind!r} reads {states.num_parts} rows in each state, and "
            f"{action_set.kind!r} takes {choices.num_parts}."
        )
        problems += [
            Problem("/algorithm/state_discretizer", detail),
            Problem("/algorithm/action_set", detail),
        ]
    return [*problems, *_of_the_size(settings, states.num_values, choices.num_values)]


def _of_the_states(
    discretizer: StateDiscretizerOptions | None, environment: EnvironmentInfo
) -> list[Problem]:
    if discretizer is None:
        detail = (
            "Name a `state_discretizer`: Q-learning needs a row of its table for what it sees in "
            f"{environment.id}."
        )
    elif state_space(discretizer, environment) is None:
        offered = ["observation_grid", *environment.finite.state_discretizers]
        detail = _not_offered("state discretizer", discretizer.kind, offered, environment)
    elif isinstance(discretizer, ObservationGrid):
        return _of_the_observation(discretizer, environment)
    elif isinstance(discretizer, DiskPositionGrid) and discretizer.looks_at not in environment.info:
        told = ", ".join(environment.info) or "nothing besides its observation"
        detail = (
            f"The state discretizer {discretizer.kind!r} looks at {discretizer.looks_at}, and "
            f"{environment.id} tells {told}."
        )
    else:
        return []
    return [Problem("/algorithm/state_discretizer", detail)]


def _of_the_actions(action_set: ActionSetOptions | None, environment: EnvironmentInfo) -> list[Problem]:
    size = environment.action_size
    if action_set is None:
        detail = (
            f"Name an `action_set`: the action of {environment.id} is "
            f"{'continuous' if size is None else f'{size} continuous numbers'}, and a table has columns."
        )
        return [Problem("/algorithm/action_set", detail)]
    choices = choice_space(action_set, environment)
    if choices is None:
        parts = ["arm_actions"] if environment.finite.action_parts > 1 else []
        offered = ["actions", *parts, *environment.finite.action_sets]
        detail = _not_offered("action set", action_set.kind, offered, environment)
        return [Problem("/algorithm/action_set", detail)]
    if isinstance(action_set, ActionList | ArmActions):
        lengths, parts = {len(action) for action in action_set.actions}, choices.num_parts
        if len(lengths) > 1 or (size is not None and lengths != {size / parts}):
            detail = (
                f"{environment.id} takes {size} action components"
                f"{f' in {parts} equal parts' if parts > 1 else ''}; "
                f"the action set's actions have {', '.join(str(length) for length in sorted(lengths))}."
            )
            return [Problem("/algorithm/action_set/actions", detail)]
    return []


def _not_offered(what: str, kind: str, offered: list[str], environment: EnvironmentInfo) -> str:
    why = environment.finite.cannot_offer.get(kind)
    reason = f": {why}" if why else ""
    return (
        f"{environment.id} offers no {what} {kind!r} under these options{reason}. It offers "
        f"{', '.join(offered)}."
    )


def _of_the_observation(discretizer: ObservationGrid, environment: EnvironmentInfo) -> list[Problem]:
    size = environment.observation_size
    if size is None:
        return []
    detail = f"The observation of {environment.id} has {size} components, and none of index"
    return [
        Problem(f"/algorithm/state_discretizer/components/{place}/index", f"{detail} {index}.")
        for place, index in discretizer.beyond(size).items()
    ]


def _of_the_size(settings: QLearningSpec, rows: int, columns: int) -> list[Problem]:
    problems = list[Problem]()
    if (cells := rows * columns * settings.num_agents) > MAX_CELLS:
        detail = f"The tables would have {cells:,} cells; {MAX_CELLS:,} are allowed."
        problems.append(Problem("/algorithm/state_discretizer", detail))
    if settings.initial_table == "identity" and rows != columns:
        detail = f"An identity table is square; this one has {rows:,} rows and {columns:,} columns."
        problems.append(Problem("/algorithm/initial_table", detail))
    return problems


def _of_the_schedule(settings: QLearningSpec) -> list[Problem]:
    epsilon = settings.epsilon
    where = "/algorithm/epsilon"
    lengths = (
        ("decay_episodes", epsilon.decay_episodes, settings.num_updates * settings.num_envs, "episodes"),
        ("decay_decisions", epsilon.decay_decisions, settings.num_decisions, "decisions of an agent"),
    )
    problems = [
        Problem(f"{where}/{name}", f"{name} = {length:,}, and the run has {most:,} {unit}.")
        for name, length, most, unit in lengths
        if length is not None and length > most
    ]
    if epsilon.decay_episodes is not None and epsilon.decay_decisions is not None:
        detail = "epsilon decays over episodes or over decisions, not over both."
        problems += [Problem(f"{where}/decay_episodes", detail), Problem(f"{where}/decay_decisions", detail)]
    ends = [epsilon.start, epsilon.end, *(agent.epsilon_start for agent in settings.agents)]
    ends += [agent.epsilon_end for agent in settings.agents]
    if epsilon.shape == "exponential" and 0.0 in ends:
        detail = "An exponential schedule of epsilon never comes from or to 0; take a small number."
        problems.append(Problem(f"{where}/shape", detail))
    return problems


def _of_the_envs(settings: QLearningSpec) -> list[Problem]:
    if settings.num_parallel_envs <= MAX_ENVS:
        return []
    detail = (
        f"{settings.num_agents:,} agents with {settings.num_envs:,} environments each are "
        f"{settings.num_parallel_envs:,} environments; {MAX_ENVS:,} are allowed."
    )
    return [Problem("/algorithm/num_envs", detail)]


def _of_the_replay(settings: QLearningSpec, environment: EnvironmentInfo) -> list[Problem]:
    size, agents = settings.replay_buffer_size, settings.num_agents
    discretizer = settings.state_discretizer
    states = state_space(discretizer, environment) if discretizer is not None else None
    brought = settings.num_envs * (states.num_parts if states is not None else 1)
    problems = list[Problem]()
    if 0 < size < brought:
        problems.append(
            _of_the_buffer(f"buffer_size = {size}, and each decision brings {brought} transitions.")
        )
    if size * agents > MAX_REPLAYED:
        detail = (
            f"{agents:,} agents with buffer_size = {size:,} keep {size * agents:,} transitions; "
            f"{MAX_REPLAYED:,} are allowed."
        )
        problems.append(_of_the_buffer(detail))
    return problems


def _of_the_buffer(detail: str) -> Problem:
    return Problem("/algorithm/replay/buffer_size", detail)
