"""A trained policy of any algorithm, as rollouts and videos use it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax

from core.algorithms.activations import ActivationReader, LatentNoise
from core.algorithms.catalog import ALGORITHMS, loaded
from core.algorithms.checkpoint import kind_of, of_seed
from core.algorithms.export.network import network_in
from core.algorithms.policy_file import PolicyParams
from core.environments.environment import Environment, State
from core.environments.rollout import ParametricPolicy
from core.environments.wrappers.action_repeat import ActionHold


class Acting(NamedTuple):
    """How a policy acts in an environment. environment: the environment itself, or a wrapper of it that
    remembers decisions. act: (parameters, state, key) -> action [action_size]."""

    environment: Environment
    act: ParametricPolicy


@dataclass(frozen=True)
class TrainedPolicy:
    """A policy's parameters and a function of them: a later checkpoint's need no new compilation.

    acting: how it acts in an environment like the one it was trained in. A caller without an environment uses
    `gaitway.policy`. activations: makes the reader of its layers, or raises NotExportable; None: it has no
    layers that can be read. answer: (parameters, observations [..., n], key) -> actions [..., action_size];
    None: it takes more than observations.
    """

    parameters: Any
    acting: Callable[[Environment], Acting]
    activations: Callable[[], ActivationReader] | None = None
    answer: Callable[[Any, Any, jax.Array], jax.Array] | None = None


def of_network(
    parameters: PolicyParams,
    answer: Callable[[Any, Any, jax.Array], jax.Array],
    latent_noise: LatentNoise | None = None,
) -> TrainedPolicy:
    """A policy that takes observations alone. answer: (parameters, observation, key) -> action [action_size];
    latent_noise: that of its intentions."""
    action_repeat = parameters.config.action_repeat

    def acting(environment: Environment) -> Acting:
        if action_repeat == 1:
            return Acting(environment, lambda params, state, key: answer(params, state.obs, key))

        def act(params: Any, state: State, key: jax.Array) -> jax.Array:
            return ActionHold.due_or_held(state, action_repeat, answer(params, state.obs, key))

        return Acting(ActionHold(environment), act)

    def activations() -> ActivationReader:
        return ActivationReader(network_in(parameters), latent_noise)

    return TrainedPolicy(parameters, acting, activations, answer)


def policy_from_checkpoint(
    content: bytes, *, deterministic: bool = True, seed: int | None = None
) -> TrainedPolicy:
    """The policy in a checkpoint; seed: of a job of several seeds. Raises JobFailed where it is damaged."""
    if seed is not None:
        content = of_seed(content, seed)
    return load_policy(content, kind_of(content), is_checkpoint=True, deterministic=deterministic)


def load_policy(
    content: bytes, algorithm: str, *, is_checkpoint: bool, deterministic: bool = True
) -> TrainedPolicy:
    """The policy in a checkpoint or in a policy file of this algorithm.

    deterministic: without the exploration's noise. Raises JobFailed where the file is damaged.
    """
    return loaded(ALGORITHMS[algorithm].policy)(
        content, is_checkpoint=is_checkpoint, deterministic=deterministic
    )
