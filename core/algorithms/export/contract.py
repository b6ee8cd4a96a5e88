"""The meaning of an exported policy's numbers: its observation, its action, and how often it acts."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from core.algorithms.export.network import PolicyNetwork

FORMAT, VERSION = "gaitway-policy", 1
# Of files with an encoder, which readers of the first version would leave out.
VERSION_WITH_ENCODER = 2

# Slices in their order, which cover the whole: name, start, size, unit, and others such as low and high.
Parts = Sequence[Mapping[str, Any]]


@dataclass(frozen=True)
class PolicyOrigin:
    """Where a policy comes from.

    options: all of the environment's. step_s: seconds of one environment step. trained_steps: environment
    steps that the policy has learnt from. The parts: none where the environment does not name them. robot:
    what a robot needs (`core.environments.deployment`), of a task whose actions are targets of joints.
    """

    algorithm: str
    environment: str
    options: Mapping[str, Any]
    step_s: float
    trained_steps: int
    observation_parts: Parts = ()
    action_parts: Parts = ()
    robot: Mapping[str, Any] | None = None


def contract(network: PolicyNetwork, origin: PolicyOrigin) -> dict[str, Any]:
    """The contract as a JSON document (docs/export.md). Where no parts have names, the whole is one."""
    observation, action = network.observation_size, network.action_size
    encoder = {}
    if network.encoder:
        encoder = {"encoder": {"num_layers": len(network.encoder), "encoded": list(network.encoded)}}
    robot = {} if origin.robot is None else {"robot": dict(origin.robot)}
    return {
        **robot,
        "format": FORMAT,
        "version": VERSION_WITH_ENCODER if network.encoder else VERSION,
        "algorithm": origin.algorithm,
        "environment": {"id": origin.environment, "options": dict(origin.options)},
        "trained_steps": origin.trained_steps,
        "observation": {
            "name": network.observation_name,
            "size": observation,
            "dtype": "float32",
            "parts": _covering(origin.observation_parts, network.observation_name, observation),
        },
        "action": {
            "size": action,
            "dtype": "float32",
            "low": -1.0,
            "high": 1.0,
            "parts": _covering(origin.action_parts, "action", action),
            "held_steps": network.action_repeat,
            "held_s": round(network.action_repeat * origin.step_s, 9),
        },
        "network": {
            "num_layers": len(network.layers),
            "activation": network.activation,
            "normalized_max_abs": network.max_abs,
            **encoder,
        },
    }


def as_text(about: Mapping[str, Any]) -> str:
    """Equal contracts give equal text."""
    return json.dumps(about, sort_keys=True, ensure_ascii=False)


def _covering(parts: Parts, name: str, size: int) -> list[Mapping[str, Any]]:
    """The parts, if they are those of this array; of an environment's several observations none are named."""
    if sum(part["size"] for part in parts) == size:
        return [*parts]
    return [{"name": name, "start": 0, "size": size, "unit": None}]
