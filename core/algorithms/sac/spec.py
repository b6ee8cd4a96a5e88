"""SAC's hyperparameters, by Brax's names where Brax has them (brax.training.agents.sac.train)."""

from typing import ClassVar, Literal

from pydantic import Field

from core.algorithms.ppo.spec import Activation, LayerSizes
from core.algorithms.spec import BaseSpec


class SACSpec(BaseSpec):
    """Soft actor-critic (Haarnoja et al., 2018) in many environments at once, with critics that estimate the
    return's distribution (Bellemare et al., 2017), as in FastTD3 (Seo et al., 2025).

    A field that is not given takes the value tuned for the environment and the device, if there is
    one, and otherwise the default shown here; `GET /environments/{id}` shows the result.
    """

    fixed_by_checkpoint: ClassVar[tuple[str, ...]] = (
        "num_envs",
        "env_steps_per_update",
        "action_repeat",
        "replay_rows",
        "policy_hidden_layer_sizes",
        "q_hidden_layer_sizes",
        "q_network_layer_norm",
        "activation",
        "num_atoms",
        "value_min",
        "value_max",
        "normalize_observations",
        "normalize_observations_max_abs_value",
        "returns_to_first_state",
    )
    checkpoint_holds_envs: ClassVar[bool] = True

    kind: Literal["sac"] = "sac"
    num_timesteps: int = Field(
        default=2_000_000, ge=1, le=10**12, description="Environment steps to train for."
    )
    num_envs: int = Field(default=128, ge=1, le=2**20, description="Environments that run side by side.")
    episode_length: int = Field(
        default=1000,
        ge=1,
        le=10**6,
        description="Steps after which an episode is cut off, rounded up to whole actions.",
    )
    action_repeat: int = Field(
        default=1,
        ge=1,
        le=1000,
        description="Environment steps per action; their rewards are summed. All step counts are in "
        "environment steps, except unroll_length and n_step.",
    )
    reset_pool_size: int = Field(
        default=128,
        ge=0,
        le=2**16,
        description="Fresh initial states drawn per update; each episode that begins in it starts from a "
        "random one of them. 0: every environment returns to its own first state, as in Brax.",
    )
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
        default=0.02, gt=0, le=1, description="How far the target critics follow in a gradient step."
    )
    num_atoms: int = Field(
        default=101, ge=2, le=10_000, description="Values among which a critic's return is distributed."
    )
    value_min: float = Field(default=-100.0, ge=-1e6, le=1e6, description="The lowest of these values.")
    value_max: float = Field(default=100.0, ge=-1e6, le=1e6, description="The highest of these values.")
    init_alpha: float = Field(
        default=0.01, gt=0, le=100, description="First weight of the policy's entropy, which is learnt."
    )
    target_entropy_per_action: float = Field(
        default=-0.5, ge=-10, le=10, description="The entropy wanted for each component of an action."
    )
    normalize_observations: bool = Field(
        default=True, description="Normalise the networks' observations to mean 0 and deviation 1."
    )
    normalize_observations_max_abs_value: float | None = Field(
        default=None,
        gt=0,
        le=1e6,
        description="Bound on normalised observations, in standard deviations. null: no bound, as in Brax.",
    )
    num_evals: int = Field(
        default=10, ge=0, le=10_000, description="Evaluations, spread evenly; the last is at the end."
    )
    num_eval_envs: int = Field(default=16, ge=1, le=2**16, description="Episodes per evaluation.")
    deterministic_eval: bool = True
    policy_hidden_layer_sizes: LayerSizes = [256, 256]
    q_hidden_layer_sizes: LayerSizes = [256, 256]
    q_network_layer_norm: bool = Field(
        default=True, description="Layer normalisation in the critics (Ba et al., 2016)."
    )
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
    def num_parallel_envs(self) -> int:
        return self.num_envs

    @property
    def budget(self) -> int:
        return self.num_timesteps
