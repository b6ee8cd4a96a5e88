"""A trained network on its own: out of a checkpoint, as a file, and acting."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from flax import serialization
from pydantic import TypeAdapter

from core.algorithms.brax_training import RunningStatisticsState, init_normalizer, normalization
from core.algorithms.checkpoint import Format
from core.algorithms.dqn.network import QNetwork
from core.algorithms.q_learning.discrete_env import make_action_set
from core.algorithms.q_learning.spec import ActionSetOptions
from core.algorithms.trained_policy import Acting, TrainedPolicy
from core.environments.environment import ActionSet, Environment, State
from core.environments.wrappers.action_repeat import ActionHold
from core.errors import JobFailed
from core.reasons import Reason

FORMAT = Format("gaitway-dqn-1")

_ACTION_SET: TypeAdapter[ActionSetOptions] = TypeAdapter(ActionSetOptions)


class DqnParameters(NamedTuple):
    """network: Brax's parameters."""

    normalizer: RunningStatisticsState
    network: Any


# (parameters, observation [..., obs], key) -> choices [..., parts] int32
Choose = Callable[[DqnParameters, Any, jax.Array], jax.Array]


def write_policy(normalizer: Any, network: Any, facts: Mapping[str, Any]) -> bytes:
    """The file of a policy: equal parameters give equal bytes. It has the parts of a checkpoint that acting
    needs, under the same names."""
    return FORMAT.pack(facts, {}, {"normalizer": normalizer, "params": network})


def read_policy(content: bytes) -> tuple[DqnParameters, Mapping[str, Any]]:
    """The parameters in a checkpoint or a policy file, and its facts: the settings that a checkpoint fixes,
    `num_parts`, `num_choices`, and `epsilon`, the share of random choices at the end.

    Raises JobFailed("bad_checkpoint") where the file is damaged.
    """
    facts, state = FORMAT.read(content)
    template = jax.device_get(init_normalizer(facts["observation_size"]))
    normalizer: Any = serialization.from_state_dict(template, state["normalizer"])
    return DqnParameters(normalizer, state["params"]), facts


def make_choose(facts: Mapping[str, Any], *, deterministic: bool = True) -> Choose:
    """The choice of a policy of these facts; pure, to be jitted by the caller."""
    sizes = tuple(facts["hidden_layer_sizes"])
    network = QNetwork(facts["num_parts"], facts["num_choices"], sizes, facts["activation"])
    normalize = normalization(facts["normalize_observations_max_abs_value"])
    epsilon = None if deterministic else jnp.float32(facts["epsilon"])

    def choose(parameters: DqnParameters, observation: Any, key: jax.Array) -> jax.Array:
        seen = observation
        if facts["normalize_observations"]:
            seen = normalize(observation, parameters.normalizer)
        return network.choose(parameters.network, seen, epsilon, key)

    return choose


def load(content: bytes, *, is_checkpoint: bool, deterministic: bool = True) -> TrainedPolicy:
    """The policy of a checkpoint or a policy file, ready to act. Raises JobFailed if it is damaged."""
    parameters, facts = read_policy(content)
    choose = make_choose(facts, deterministic=deterministic)
    options = _ACTION_SET.validate_python(facts["action_set"])

    def acting(environment: Environment) -> Acting:
        action_set = make_action_set(options, environment)
        _check_shape(facts, environment, action_set)

        def act(parameters: DqnParameters, state: State, key: jax.Array) -> jax.Array:
            due = action_set.act(choose(parameters, state.obs, key))
            return ActionHold.due_or_held(state, facts["action_repeat"], due)

        return Acting(ActionHold(environment), act)

    return TrainedPolicy(parameters, acting)


def _check_shape(facts: Mapping[str, Any], environment: Environment, action_set: ActionSet) -> None:
    """Raises JobFailed("bad_checkpoint") where the network is one of another environment."""
    names = ("observation_size", "num_parts", "num_choices")
    sizes = [facts[name] for name in names]
    wanted = [environment.observation_size, action_set.num_parts, action_set.num_choices]
    if sizes != wanted:
        raise JobFailed(
            Reason.BAD_CHECKPOINT,
            f"The network has {', '.join(names)} = {sizes}, and this environment needs {wanted}.",
        )
