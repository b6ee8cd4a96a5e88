"""The hyperparameters that off-policy algorithms share, by Brax's names where Brax has them.

Also which of them go together, and the memory of a replay.
"""

from typing import ClassVar

from pydantic import Field

from core.algorithms.memory import FLOAT_BYTES, MemoryPart, shown
from core.algorithms.ppo.spec import Activation
from core.algorithms.spec import (
    BaseSpec,
    EpisodeLength,
    NormalizeObservations,
    NormalizeObservationsMaxAbsValue,
    NumEnvs,
    NumEvalEnvs,
    NumEvals,
    NumTimesteps,
    ResetPoolSize,
    check_curriculum,
    rejected,
)
from core.environments.info import EnvironmentInfo
from core.errors import Rejected


class OffPolicySpec(BaseSpec):
    """Many environments act side by side, what they see is kept, and networks learn from samples of it.

    An update is `unroll_length` actions in each environment, followed by the gradient steps for them.
    """

    checkpoint_holds_envs: ClassVar[bool] = True
    arguments: ClassVar[tuple[str, ...]] = ("learning_rate", "discounting", "reward_scaling", "tau")
    why_no_seeds: ClassVar[str | None] = None

    num_timesteps: NumTimesteps = 2_000_000
    num_envs: NumEnvs = 128
    episode_length: EpisodeLength = 1000
    action_repeat: int = Field(
        default=1,
        ge=1,
        le=1000,
        description="Environment steps per action; their rewards are summed. All step counts are in "
        "environment steps, except unroll_length and n_step.",
    )
    reset_pool_size: ResetPoolSize = 128
    unroll_length: int = Field(
        default=8, ge=1, le=10_000, description="Actions of each environment from one learning to the next."
    )
    grad_updates_per_step: int = Field(
        default=2, ge=1, le=1000, description="Gradient steps for each action of all environments."
    )
    batch_size: int = Field(default=4096, ge=1, le=2**20, description="Transitions of a gradient step.")
    min_replay_size: int = Field(
        default=8192, ge=0, le=10**9, description="Transitions that are stored before learning begins."
    )
    max_replay_size: int = Field(
        default=2**19,
        ge=1,
        le=10**9,
        description="Transitions that are kept, of all environments; checkpoints hold them.",
    )
    n_step: int = Field(
        default=3, ge=1, le=100, description="Rewards that a target adds up before it estimates the rest."
    )
    learning_rate: float = Field(default=3e-4, gt=0, le=1, description="Adam's, of all networks.")
    discounting: float = Field(default=0.97, gt=0, le=1)
    reward_scaling: float = Field(default=1.0, gt=0, le=1e6)
    tau: float = Field(
        default=0.02, gt=0, le=1, description="How far the target networks follow in a gradient step."
    )
    normalize_observations: NormalizeObservations = True
    normalize_observations_max_abs_value: NormalizeObservationsMaxAbsValue = None
    num_evals: NumEvals = 10
    num_eval_envs: NumEvalEnvs = 16
    activation: Activation = Field(
        default="relu", description="Activation function of all networks, by Brax's name."
    )

    @property
    def env_steps_per_update(self) -> int:
        """Environment steps between two times of learning."""
        return self.num_envs * self.unroll_length * self.action_repeat

    @property
    def actions_per_episode(self) -> int:
        """Actions after which an episode is cut off."""
        return -(-self.episode_length // self.action_repeat)

    @property
    def returns_to_first_state(self) -> bool:
        """Whether every environment goes back to its own first state, which its checkpoints then hold."""
        return self.reset_pool_size == 0

    @property
    def replay_rows(self) -> int:
        """Actions of each environment that are kept."""
        return max(1, self.max_replay_size // self.num_envs)

    @property
    def num_updates(self) -> int:
        """Updates that reach the budget; the last may pass it."""
        return -(-self.num_timesteps // self.env_steps_per_update)

    @property
    def num_actions(self) -> int:
        """Actions of all environments in the whole run."""
        return self.num_updates * self.unroll_length * self.num_envs

    @property
    def num_parallel_envs(self) -> int:
        return self.num_envs

    @property
    def budget(self) -> int:
        return self.num_timesteps


# A checkpoint holds the replay, and MessagePack holds 4 GiB; networks and environments take the rest.
_MOST_BYTES = 3 * 2**30


def replay_refusal(
    settings: OffPolicySpec, environment: EnvironmentInfo, numbers_per_action: int
) -> Rejected | None:
    """Why these values do not go together; None where they do. numbers_per_action: see `replay_bytes`."""
    return (
        _too_few_rows(settings)
        or _never_learns(settings)
        or _too_large_for_a_checkpoint(settings, environment, numbers_per_action)
        or check_curriculum(settings.reset_pool_size, environment)
    )


def _too_few_rows(settings: OffPolicySpec) -> Rejected | None:
    """A sample is n steps and the row after them; an update's rows are written at once."""
    needed = max(settings.unroll_length, settings.n_step + 1)
    if settings.replay_rows >= needed:
        return None
    return rejected(
        f"max_replay_size = {settings.max_replay_size} keeps {settings.replay_rows} actions of each of "
        f"{settings.num_envs} environments; with unroll_length = {settings.unroll_length} and n_step = "
        f"{settings.n_step} it has to keep {needed}: {needed * settings.num_envs} or more.",
        "max_replay_size",
        "num_envs",
        "unroll_length",
        "n_step",
    )


def _never_learns(settings: OffPolicySpec) -> Rejected | None:
    """Learning begins when so many transitions have been made, kept or not; a run has to make them."""
    made = settings.num_actions
    if settings.min_replay_size <= made:
        return None
    return rejected(
        f"The run ends after {made} transitions, before there are min_replay_size = "
        f"{settings.min_replay_size} of them to learn from.",
        "min_replay_size",
        "num_timesteps",
    )


def _too_large_for_a_checkpoint(
    settings: OffPolicySpec, environment: EnvironmentInfo, numbers_per_action: int
) -> Rejected | None:
    size = replay_bytes(settings, environment, numbers_per_action)
    if size <= _MOST_BYTES:
        return None
    return rejected(
        f"max_replay_size = {settings.max_replay_size} transitions of {environment.id} take {shown(size)}; "
        f"a checkpoint holds them and has room for {shown(_MOST_BYTES)}.",
        "max_replay_size",
    )


# Reward, and how the step ended.
_SCALARS = 3


def replay_bytes(settings: OffPolicySpec, environment: EnvironmentInfo, numbers_per_action: int) -> int:
    """The size of the replay, on the device and in a checkpoint. Unknown sizes count as 0.

    numbers_per_action: how many a row keeps of one environment's action.
    """
    observation = environment.observation_size or 0
    numbers = observation + numbers_per_action + _SCALARS
    return FLOAT_BYTES * settings.replay_rows * settings.num_envs * numbers


def replay_part(settings: OffPolicySpec, environment: EnvironmentInfo, numbers_per_action: int) -> MemoryPart:
    """The replay's part of a run's memory."""
    kept = settings.replay_rows * settings.num_envs
    size = replay_bytes(settings, environment, numbers_per_action)
    return MemoryPart(f"the {kept:,} transitions that are kept", size, ("max_replay_size",))


def environments_part(settings: OffPolicySpec, environment: EnvironmentInfo) -> MemoryPart:
    """The numbers that are certainly kept of each environment: its observation and its reward."""
    size = FLOAT_BYTES * settings.num_envs * ((environment.observation_size or 0) + 1)
    return MemoryPart(f"{settings.num_envs:,} environments", size, ("num_envs",))
