"""A trained policy of any algorithm: for rollouts, videos and notebooks."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

from core.algorithms.catalog import ALGORITHMS, loaded
from core.algorithms.checkpoint import kind_of
from core.environments.environment import Environment
from core.environments.rollout import ParametricPolicy


class Acting(NamedTuple):
    """How a policy acts in an environment. environment: the environment itself, or a wrapper of it that
    remembers decisions. act: (parameters, state, key) -> action [action_size]."""

    environment: Environment
    act: ParametricPolicy


@dataclass(frozen=True)
class TrainedPolicy:
    """A policy's parameters and a function of them: a later checkpoint's need no new compilation.

    acting: how it acts in an environment like the one it was trained in. A caller without an environment uses
    `gaitway.policy`.
    """

    parameters: Any
    acting: Callable[[Environment], Acting]


def policy_from_checkpoint(content: bytes, *, deterministic: bool = True) -> TrainedPolicy:
    """The policy in a checkpoint. Raises JobFailed where it is damaged."""
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
