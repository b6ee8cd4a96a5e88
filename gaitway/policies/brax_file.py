"""Reads the policy file of a PPO or SAC run: a pickle that Brax reads, too, followed by JSON."""

import json
from typing import Any

from gaitway.errors import PolicyUnreadable
from gaitway.policies import brax_pickle


def read(content: bytes) -> tuple[Any, Any, dict[str, Any]]:
    """The normaliser (a dict with `mean` and `std`), the policy network's parameters, and the hyperparameters
    that differ from Brax's defaults. The file is read as data: nothing that it names is called.
    Raises PolicyUnreadable."""
    try:
        (normalizer, policy, _), rest = brax_pickle.read(content)
        _check(normalizer, policy)
        return normalizer, policy, json.loads(rest) if rest else {}
    except Exception as error:  # damaged bytes may make a decoder raise anything
        raise PolicyUnreadable("This is not a policy file, or it is damaged.") from error


def _check(normalizer: Any, policy: Any) -> None:
    """Raises an exception of some kind where these are not the parts of a policy."""
    if type(normalizer["mean"]) is not type(normalizer["std"]):
        raise ValueError("the normaliser's parts differ")
    layers = policy["params"]
    for i in range(len(layers)):
        kernel, bias = layers[f"hidden_{i}"]["kernel"], layers[f"hidden_{i}"]["bias"]
        if kernel.ndim != 2 or bias.shape != kernel.shape[1:]:
            raise ValueError(f"layer {i} is none")
