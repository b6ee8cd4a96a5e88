"""The least memory of a tabular Q-learning run."""

from core.algorithms.memory import FLOAT_BYTES, Memory, Part
from core.algorithms.q_learning.options import choice_space, state_space
from core.algorithms.q_learning.spec import QLearningSpec
from core.environments.info import EnvironmentInfo

# The table; and while it learns, the visits and the errors of each cell.
_TABLES = 3
# What a transition is made of: `table.Transitions`.
_NUMBERS = 6


def least_memory(settings: QLearningSpec, environment: EnvironmentInfo, num_devices: int) -> Memory:
    """Bytes, all numbers of 4. A run without states or actions, which is refused elsewhere, has no table."""
    agents, cells = settings.num_agents, 0
    if settings.state_discretizer is not None and settings.action_set is not None:
        states = state_space(settings.state_discretizer, environment)
        choices = choice_space(settings.action_set, environment)
        if states is not None and choices is not None:
            cells = agents * states.num_values * choices.num_values
    replayed = agents * settings.replay_buffer_size
    observation = environment.observation_size or 0
    return Memory(
        (
            Part(
                f"tables of {cells:,} cells",
                FLOAT_BYTES * _TABLES * cells,
                ("the cells of the state discretizer", "agents"),
            ),
            Part(
                f"{replayed:,} transitions to replay",
                FLOAT_BYTES * _NUMBERS * replayed,
                ("replay.buffer_size", "agents"),
            ),
            Part(
                f"{settings.num_parallel_envs:,} environments",
                FLOAT_BYTES * settings.num_parallel_envs * (observation + 1),
                ("num_envs", "agents"),
            ),
        )
    )
