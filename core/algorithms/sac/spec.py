"""SAC's hyperparameters, by Brax's names where Brax has them (brax.training.agents.sac.train).

Also which of them go together, and the least memory of a run.
"""

from collections.abc import Mapping
from typing import ClassVar, Literal

from pydantic import Field

from core.algorithms.layers import plain
from core.algorithms.memory import FLOAT_BYTES, MemoryNeed, MemoryPart, perceptron
from core.algorithms.off_policy.spec import (
    OffPolicySpec,
    environments_part,
    replay_part,
    replay_refusal,
)
from core.algorithms.ppo.network_spec import LayerSizes
from core.algorithms.spec import rejected
from core.environments.info import Device, EnvironmentInfo
from core.errors import Rejected


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


def refusal(settings: SACSpec, environment: EnvironmentInfo, device: Device) -> Rejected | None:
    """Why these values do not go together; None where they do."""
    return _empty_range(settings) or replay_refusal(settings, environment, environment.action_size or 0)


def _empty_range(settings: SACSpec) -> Rejected | None:
    if settings.value_min < settings.value_max:
        return None
    return rejected(
        f"value_min = {settings.value_min:g} is not below value_max = {settings.value_max:g}: "
        "the critics need a range of returns.",
        "value_min",
        "value_max",
    )


_CRITICS = 2
# The parameters, their gradient, and Adam's two moments; and the critics that follow.
_COPIES, _COPIES_OF_CRITICS = 4, 5


def layers(settings: SACSpec, action_size: int) -> Mapping[str, int]:
    """The layers of the policy, with their sizes."""
    return plain(settings.policy_hidden_layer_sizes, action_size)


def least_memory(settings: SACSpec, environment: EnvironmentInfo, num_devices: int) -> MemoryNeed:
    """Bytes, all in float32. Left out: the engine's own arrays, and activations. Unknown sizes count as 0."""
    observation, action = environment.observation_size or 0, environment.action_size or 0
    # The policy puts out a mean and a deviation for each component.
    policy = perceptron([observation, *settings.policy_hidden_layer_sizes, 2 * action])
    critic = perceptron([observation + action, *settings.q_hidden_layer_sizes, settings.num_atoms])
    numbers = _COPIES * policy + _COPIES_OF_CRITICS * _CRITICS * critic
    return MemoryNeed(
        (
            replay_part(settings, environment, action),
            MemoryPart(
                f"networks of {policy + _CRITICS * critic:,} parameters with their gradient, Adam's moments "
                "and the critics that follow",
                FLOAT_BYTES * numbers,
                ("policy_hidden_layer_sizes", "q_hidden_layer_sizes"),
            ),
            environments_part(settings, environment),
        )
    )
