"""Which hyperparameters of Q-learning go together, and with which environment; a run's least memory."""

from core.algorithms.memory import FLOAT_BYTES, MemoryNeed, MemoryPart
from core.algorithms.q_learning.spec import (
    MAX_CELLS,
    MAX_ENVS,
    MAX_REPLAYED,
    ActionList,
    ActionSetOptions,
    ArmActions,
    DiskPositionGrid,
    ObservationGrid,
    QLearningSpec,
    StateDiscretizerOptions,
    choice_space,
    state_space,
)
from core.algorithms.spec import EPSILON_POINTER
from core.environments.info import Device, EnvironmentInfo
from core.errors import Problem, Rejected


def refusal(settings: QLearningSpec, environment: EnvironmentInfo, device: Device) -> Rejected | None:
    """Why these values do not go together, or not with this environment; None where they do."""
    problems = [
        *_of_the_table(settings, environment),
        *_of_the_schedule(settings),
        *_of_the_envs(settings),
        *_of_the_replay(settings, environment),
        *_of_the_curriculum(environment),
    ]
    if not problems:
        return None
    return Rejected(" ".join(dict.fromkeys(problem.detail for problem in problems)), problems)


def _of_the_curriculum(environment: EnvironmentInfo) -> list[Problem]:
    """A round begins every episode as the options say, so a curriculum would silently change nothing."""
    if not environment.has_curriculum:
        return []
    detail = (
        "Episodes of q_learning begin as the options say, so a curriculum would change nothing: leave it "
        "out, or take ppo, sac or dqn."
    )
    option = f"/environment/options/{environment.curriculum_option}"
    return [Problem(place, detail) for place in (option, "/algorithm/kind")]


def _of_the_table(settings: QLearningSpec, environment: EnvironmentInfo) -> list[Problem]:
    """Whether these and the environment go together, as far as its row tells."""
    discretizer, action_set = settings.state_discretizer, settings.action_set
    problems = [
        *_of_the_states(discretizer, environment),
        *problems_of_the_actions(action_set, environment, "a table has columns"),
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


def problems_of_the_actions(
    action_set: ActionSetOptions | None, environment: EnvironmentInfo, why: str
) -> list[Problem]:
    """The fault of the action set in this environment. why: what the algorithm has in place of
    continuous actions, for one that is missing."""
    size = environment.action_size
    if action_set is None:
        detail = (
            f"Name an `action_set`: the action of {environment.id} is "
            f"{'continuous' if size is None else f'{size} continuous numbers'}, and {why}."
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
    epsilon, agents = settings.epsilon, settings.agents
    ends = [end for agent in agents for end in (agent.epsilon_start, agent.epsilon_end)]
    problems = epsilon.problems(settings.num_decisions, *ends)
    num_episodes = settings.num_updates * settings.num_envs
    if epsilon.decay_episodes is not None and epsilon.decay_episodes > num_episodes:
        detail = f"decay_episodes = {epsilon.decay_episodes:,}, and the run has {num_episodes:,} episodes."
        problems.append(Problem(f"{EPSILON_POINTER}/decay_episodes", detail))
    if epsilon.decay_episodes is not None and epsilon.decay_decisions is not None:
        detail = "epsilon decays over episodes or over decisions, not over both."
        places = ("decay_episodes", "decay_decisions")
        problems += [Problem(f"{EPSILON_POINTER}/{place}", detail) for place in places]
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


# The table; and while it learns, the visits and the errors of each cell.
_TABLES = 3
# The numbers of a transition: see `table.Transitions`.
_NUMBERS = 6


def least_memory(settings: QLearningSpec, environment: EnvironmentInfo, num_devices: int) -> MemoryNeed:
    """Bytes, all numbers of 4. A run without states or actions, which is refused elsewhere, has no table."""
    agents, cells = settings.num_agents, 0
    if settings.state_discretizer is not None and settings.action_set is not None:
        states = state_space(settings.state_discretizer, environment)
        choices = choice_space(settings.action_set, environment)
        if states is not None and choices is not None:
            cells = agents * states.num_values * choices.num_values
    replayed = agents * settings.replay_buffer_size
    observation = environment.observation_size or 0
    return MemoryNeed(
        (
            MemoryPart(
                f"tables of {cells:,} cells",
                FLOAT_BYTES * _TABLES * cells,
                ("the cells of the state discretizer", "agents"),
            ),
            MemoryPart(
                f"{replayed:,} transitions to replay",
                FLOAT_BYTES * _NUMBERS * replayed,
                ("replay.buffer_size", "agents"),
            ),
            MemoryPart(
                f"{settings.num_parallel_envs:,} environments",
                FLOAT_BYTES * settings.num_parallel_envs * (observation + 1),
                ("num_envs", "agents"),
            ),
        )
    )
