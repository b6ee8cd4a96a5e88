"""Action action_sets: from columns of the table to an environment's action."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from core.algorithms.q_learning.options import ActionList, ActionSetOptions, ArmActions, ArmRoles, LeadingArm
from core.environments.cpg.roles import roles_for
from core.environments.environment import Environment
from core.errors import JobFailed
from core.reasons import Reason


@dataclass(frozen=True)
class ActionSet:
    """act: from choices [num_readers] int32, each below num_choices, to an action [action_size].

    names: the choices', for people; empty where their numbers say as much.
    """

    num_choices: int
    act: Callable[[jax.Array], jax.Array]
    names: tuple[str, ...] = ()


def make_action_set(options: ActionSetOptions, environment: Environment) -> ActionSet:
    """The action set that these options name.

    Raises JobFailed("bad_model") where the environment lacks what it needs, or takes other actions.
    """
    arms = num_arms(environment)
    match options:
        case ActionList(actions=actions):
            readers, action_set = 1, ActionSet(len(actions), _listed(actions))
        case ArmActions(actions=actions):
            readers, action_set = arms, ActionSet(len(actions), _one_after_the_other(actions))
        case LeadingArm():
            leading_arm = _of_the_generator(environment, "leading_arm")
            names = tuple(f"arm {arm}" for arm in range(arms))
            readers, action_set = 1, ActionSet(arms, lambda choices: leading_arm(choices[0]), names)
        case ArmRoles():
            names = tuple(role.name.lower() for role in roles_for(arms))
            readers, action_set = (
                arms,
                ActionSet(len(names), _of_the_generator(environment, "of_roles"), names),
            )
    size = jax.eval_shape(action_set.act, jax.ShapeDtypeStruct((readers,), jnp.int32)).shape[0]
    if size != environment.action_size:
        raise JobFailed(
            Reason.BAD_MODEL,
            f"The action set's actions have {size} components, the environment's {environment.action_size}.",
        )
    return action_set


def num_arms(environment: Environment) -> int:
    """How many arms the body has, inside whatever is wrapped around it; 1 where it has none."""
    return int(part_of(environment, "num_arms", 1))


def part_of(environment: Any, name: str, otherwise: Any) -> Any:
    """An attribute of the environment, or of the nearest one inside it that has it."""
    while environment is not None:
        if hasattr(environment, name):
            return getattr(environment, name)
        environment = getattr(environment, "environment", None)
    return otherwise


def _listed(actions: list[list[float]]) -> Callable[[jax.Array], jax.Array]:
    table = np.asarray(actions, np.float32)
    return lambda choices: jnp.asarray(table)[choices[0]]


def _one_after_the_other(actions: list[list[float]]) -> Callable[[jax.Array], jax.Array]:
    table = np.asarray(actions, np.float32)
    return lambda choices: jnp.asarray(table)[choices].reshape(-1)


def _of_the_generator(environment: Environment, name: str) -> Callable[[jax.Array], jax.Array]:
    """From a leading arm or all arms' roles to an action: `core.environments.cpg`'s environment offers it."""
    method = part_of(environment, name, None)
    if method is None:
        raise JobFailed(
            Reason.BAD_MODEL, "The environment has no central pattern generator that an action set could set."
        )
    return method
