"""The deep Q-network's hyperparameters."""

from typing import ClassVar, Literal

from pydantic import Field

from core.algorithms.epsilon import EpsilonSchedule
from core.algorithms.off_policy.spec import OffPolicySpec
from core.algorithms.ppo.spec import LayerSizes
from core.algorithms.q_learning.options import ActionSetOptions


class DQNSpec(OffPolicySpec):
    """A deep Q-network (Mnih et al., 2015), of the kind that estimates less too much (double DQN, van Hasselt
    et al., 2016): what the table of `q_learning` does, for observations that no table could list.

    A field that is not given takes the value tuned for the environment and the device, if there is
    one, and otherwise the default shown here; `GET /environments/{id}` shows the result.
    """

    fixed_by_checkpoint: ClassVar[tuple[str, ...]] = (
        "num_envs",
        "env_steps_per_update",
        "action_repeat",
        "action_set",
        "replay_rows",
        "hidden_layer_sizes",
        "activation",
        "normalize_observations",
        "normalize_observations_max_abs_value",
        "returns_to_first_state",
    )

    kind: Literal["dqn"] = "dqn"
    action_set: ActionSetOptions | None = Field(
        default=None, description="The choices: what each of the network's outputs is the value of."
    )
    num_timesteps: int = Field(
        default=500_000,
        ge=1,
        le=10**12,
        description="Environment steps to train for, those before a checkpoint that it resumes included.",
    )
    num_envs: int = Field(default=32, ge=1, le=2**20, description="Environments that run side by side.")
    unroll_length: int = Field(
        default=1, ge=1, le=10_000, description="Actions of each environment from one learning to the next."
    )
    batch_size: int = Field(default=256, ge=1, le=2**20, description="Transitions of a gradient step.")
    min_replay_size: int = Field(
        default=1000, ge=0, le=10**9, description="Transitions that are stored before learning begins."
    )
    max_replay_size: int = Field(
        default=2**17,
        ge=1,
        le=10**9,
        description="Transitions that are kept, of all environments; checkpoints hold them.",
    )
    n_step: int = Field(
        default=1, ge=1, le=100, description="Rewards that a target adds up before it estimates the rest."
    )
    learning_rate: float = Field(default=1e-3, gt=0, le=1, description="Adam's.")
    epsilon: EpsilonSchedule = EpsilonSchedule(start=1.0)
    hidden_layer_sizes: LayerSizes = [64, 64]
