"""SAC's hyperparameters, by Brax's names where Brax has them (brax.training.agents.sac.train)."""

from typing import ClassVar, Literal

from pydantic import Field

from core.algorithms.off_policy.spec import OffPolicySpec
from core.algorithms.ppo.spec import LayerSizes


class SACSpec(OffPolicySpec):
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
    arguments: ClassVar[tuple[str, ...]] = (*OffPolicySpec.arguments, "target_entropy_per_action")

    trains_in_parts: ClassVar[bool] = True

    kind: Literal["sac"] = "sac"
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
    deterministic_eval: bool = True
    policy_hidden_layer_sizes: LayerSizes = [256, 256]
    q_hidden_layer_sizes: LayerSizes = [256, 256]
    q_network_layer_norm: bool = Field(
        default=True, description="Layer normalisation in the critics (Ba et al., 2016)."
    )

    @property
    def read_at_start(self) -> tuple[str, ...]:
        return ("init_alpha",)
