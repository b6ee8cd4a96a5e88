"""A policy file as the numbers of one network."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.algorithms.policy_file import PolicyParams, read_policy

Numbers = NDArray[np.float32]


class NotExportable(Exception):
    """The message says what the exported files cannot express."""


@dataclass(frozen=True)
class PolicyLayer:
    """kernel: [inputs, outputs]; bias: [outputs]."""

    kernel: Numbers
    bias: Numbers


@dataclass(frozen=True)
class PolicyNetwork:
    """observation ↦ tanh(location), where the last layer gives location and scale, one after the other.

    mean, std: of observations, [observation_size]. max_abs: bound on the normalised observation; None: none.
    layers: an activation follows each but the last, whose outputs are 2 × action_size. observation_name:
    which one the policy sees, where an environment has several by name. action_repeat: environment steps for
    which an action is held.

    encoder: layers that see the numbers `encoded` of the normalised observation; the first half of their
    outputs, and then the other numbers, are what `layers` see. Empty: `layers` see the observation.
    """

    mean: Numbers
    std: Numbers
    max_abs: float | None
    layers: tuple[PolicyLayer, ...]
    activation: str
    observation_name: str
    action_repeat: int
    encoder: tuple[PolicyLayer, ...] = ()
    encoded: tuple[int, ...] = ()

    @property
    def observation_size(self) -> int:
        return len(self.mean)

    @property
    def action_size(self) -> int:
        return len(self.layers[-1].bias) // 2

    @property
    def size_bytes(self) -> int:
        """The size of all weights and biases."""
        return sum(layer.kernel.nbytes + layer.bias.nbytes for layer in (*self.encoder, *self.layers))

    @property
    def not_encoded(self) -> tuple[int, ...]:
        """The other numbers of the observation than `encoded`."""
        return tuple(sorted({*range(self.observation_size)} - {*self.encoded}))


def network_of(policy_file: bytes) -> PolicyNetwork:
    """The network in a policy file of PPO or SAC.

    Raises JobFailed where the file is damaged, and NotExportable for a network with other parts than these.
    """
    return network_in(read_policy(policy_file))


def network_in(params: PolicyParams) -> PolicyNetwork:
    """The network of these parameters. Raises NotExportable for a network with other parts than these."""
    config = params.config
    mean: Any = params.normalizer.mean
    std: Any = params.normalizer.std
    if isinstance(mean, Mapping):
        mean, std = mean[config.policy_obs_key], std[config.policy_obs_key]
    parts = params.policy["params"]
    has_encoder = config.encoder_places is not None
    return PolicyNetwork(
        mean=_float32(mean),
        std=_float32(std),
        max_abs=config.normalize_observations_max_abs_value,
        layers=_layers(parts["decoder"] if has_encoder else parts),
        activation=config.activation,
        observation_name=config.policy_obs_key,
        action_repeat=config.action_repeat,
        encoder=_layers(parts["encoder"]) if has_encoder else (),
        encoded=tuple(
            start + number for start, size in config.encoder_places or () for number in range(size)
        ),
    )


def _layers(parts: Any) -> tuple[PolicyLayer, ...]:
    names = [f"hidden_{i}" for i in range(len(parts))]
    unknown = {name for name in parts if name not in names}
    unknown |= {name for name in names if parts.get(name, {}).keys() != {"kernel", "bias"}}
    if unknown:
        raise NotExportable(f"its network has parts that exports do not know: {', '.join(sorted(unknown))}")
    return tuple(
        PolicyLayer(_float32(parts[name]["kernel"]), _float32(parts[name]["bias"])) for name in names
    )


def _float32(values: Any) -> Numbers:
    return np.asarray(values, np.float32)
