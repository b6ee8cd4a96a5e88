"""A trained policy of any algorithm, as rollouts and videos use it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

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
