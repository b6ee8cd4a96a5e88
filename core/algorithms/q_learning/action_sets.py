"""From a job's options to an action set: one that the environment offers, or a list of actions."""

import jax.numpy as jnp
import numpy as np

from core.algorithms.q_learning.options import (
    ActionList,
    ActionSetOptions,
    ArmActions,
    ArmAmplitudes,
    ArmRoles,
    LeadingArm,
)
from core.environments.discretization import ActionSet
from core.environments.environment import Environment
from core.errors import JobFailed
from core.reasons import Reason


def make_action_set(options: ActionSetOptions, environment: Environment) -> ActionSet:
    """The action set that these options name.

    Raises JobFailed("bad_model") where the environment does not offer it, or takes other actions.
    """
    match options:
        case LeadingArm() | ArmRoles() | ArmAmplitudes():
            offered = environment.discretization.action_sets.get(options.kind)
            if offered is None:
                raise JobFailed(Reason.BAD_MODEL, f"The environment offers no action set {options.kind!r}.")
            return offered
        case ActionList(actions=actions) | ArmActions(actions=actions):
            table, size = np.asarray(actions, np.float32), environment.action_size
            length = table.shape[1]
            parts = size // length if isinstance(options, ArmActions) else 1
            if parts * length != size:
                detail = f"The action set's actions have {length} components, the environment's {size}."
                raise JobFailed(Reason.BAD_MODEL, detail)
            return ActionSet(len(table), parts, lambda choices: jnp.asarray(table)[choices].reshape(-1))
