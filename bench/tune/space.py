"""The settings among which a search chooses."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import optuna

from core.algorithms.catalog import resolve
from core.algorithms.ppo.spec import PPOSpec
from core.environments import catalog
from core.environments.info import Device

_LAYERS: Mapping[str, list[int]] = {
    "1x64": [64],
    "2x32": [32] * 2,
    "2x64": [64] * 2,
    "2x128": [128] * 2,
    "2x256": [256] * 2,
    "3x64": [64] * 3,
    "4x32": [32] * 4,
    "3x256": [256] * 3,
    "5x256": [256] * 5,
}
_POLICIES = ("2x32", "2x64", "4x32")
_ACTIVATIONS = ("swish", "tanh", "elu")
_MOST = {"log2_num_envs": 11, "log2_unrolls_per_env": 3, "log2_num_minibatches": 5}


def settings_of(trial: optuna.trial.BaseTrial) -> dict[str, Any]:
    """Hyperparameters by name. An update has 1 to 8 unrolls of each environment, so that it divides them."""
    num_envs = 2 ** trial.suggest_int("log2_num_envs", 5, _MOST["log2_num_envs"])
    unrolls = num_envs * 2 ** trial.suggest_int("log2_unrolls_per_env", 0, _MOST["log2_unrolls_per_env"])
    num_minibatches = 2 ** trial.suggest_int("log2_num_minibatches", 1, _MOST["log2_num_minibatches"])
    is_adaptive = trial.suggest_categorical("adaptive", [False, True])
    return {
        "num_envs": num_envs,
        "unroll_length": trial.suggest_int("unroll_length", 4, 20),
        "num_minibatches": num_minibatches,
        "batch_size": unrolls // num_minibatches,
        "num_updates_per_batch": trial.suggest_int("num_updates_per_batch", 1, 8),
        "learning_rate": trial.suggest_float("learning_rate", 1e-4, 3e-3, log=True),
        "learning_rate_schedule": "ADAPTIVE_KL" if is_adaptive else "NONE",
        "entropy_cost": trial.suggest_float("entropy_cost", 1e-5, 3e-2, log=True),
        "discounting": 1.0 - trial.suggest_float("1 - discounting", 0.005, 0.1, log=True),
        "gae_lambda": trial.suggest_float("gae_lambda", 0.85, 0.99),
        "clipping_epsilon": trial.suggest_float("clipping_epsilon", 0.1, 0.4),
        "reward_scaling": trial.suggest_float("reward_scaling", 0.03, 1_000.0, log=True),
        "policy_hidden_layer_sizes": _LAYERS[trial.suggest_categorical("policy", _POLICIES)],
        "value_hidden_layer_sizes": _LAYERS[trial.suggest_categorical("value", list(_LAYERS))],
        "activation": trial.suggest_categorical("activation", _ACTIVATIONS),
        "bootstrap_on_timeout": trial.suggest_categorical("bootstrap_on_timeout", [False, True]),
        "normalize_observations": True,
    }


def first_trial(environment: str, device: Device) -> dict[str, Any]:
    """The settings that a search tries first: the present ones, as near as the space has them."""
    has = resolve(PPOSpec(), catalog.find(environment), device)
    unrolls = has.batch_size * has.num_minibatches
    sizes = {
        "log2_num_envs": has.num_envs,
        "log2_unrolls_per_env": unrolls // has.num_envs,
        "log2_num_minibatches": has.num_minibatches,
    }
    return {
        **{name: min(_MOST[name], max(1, size).bit_length() - 1) for name, size in sizes.items()},
        "unroll_length": has.unroll_length,
        "num_updates_per_batch": has.num_updates_per_batch,
        "learning_rate": has.learning_rate,
        "adaptive": has.learning_rate_schedule == "ADAPTIVE_KL",
        "entropy_cost": max(1e-5, has.entropy_cost),
        "1 - discounting": 1.0 - has.discounting,
        "gae_lambda": has.gae_lambda,
        "clipping_epsilon": has.clipping_epsilon,
        "reward_scaling": has.reward_scaling,
        "policy": _named(has.policy_hidden_layer_sizes, _POLICIES),
        "value": _named(has.value_hidden_layer_sizes, list(_LAYERS)),
        "bootstrap_on_timeout": has.bootstrap_on_timeout,
        "activation": has.activation if has.activation in _ACTIVATIONS else "swish",
    }


def _named(sizes: Sequence[int], names: Sequence[str]) -> str:
    """The network of these layers, or the one whose number of weights comes nearest."""

    def num_weights(layers: Sequence[int]) -> int:
        return sum(a * b for a, b in pairwise(layers)) + sum(layers)

    return min(
        names,
        key=lambda name: (_LAYERS[name] != list(sizes), abs(num_weights(_LAYERS[name]) - num_weights(sizes))),
    )
