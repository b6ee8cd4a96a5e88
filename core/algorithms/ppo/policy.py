"""A trained policy: read from a checkpoint, written to a file that Brax reads, and as a function."""

import io
import json
import pickle
from collections.abc import Callable
from dataclasses import asdict
from enum import Enum
from typing import Any, cast

import jax
import numpy as np
from flax import serialization

from core.algorithms.brax_training import make_inference_fn
from core.algorithms.normalizer import init_normalizer
from core.algorithms.ppo.checkpoint import FORMAT
from core.algorithms.ppo.networks import PolicyConfig, PolicyParams, make_networks
from core.algorithms.ppo.spec import PPOSpec
from core.algorithms.trained_policy import Acting, TrainedPolicy
from core.environments.environment import Environment, ObservationSize, State
from core.environments.wrappers.action_hold import ActionHold
from core.errors import JobFailed
from core.reasons import Reason

Inference = Callable[[Any, jax.Array], jax.Array]
# (normaliser, policy, value), with the default config
Triple = tuple[Any, Any, Any]

# Everything that a policy file names besides plain containers.
_ALLOWED = {
    ("brax.training.acme.running_statistics", "NormalizationMode"),
    ("brax.training.acme.running_statistics", "RunningStatisticsState"),
    ("brax.training.types", "UInt64"),
    ("numpy", "dtype"),
    ("numpy", "ndarray"),
    ("numpy._core.multiarray", "_reconstruct"),
    ("numpy._core.multiarray", "scalar"),
    ("numpy._core.numeric", "_frombuffer"),
}


def make_inference(params: PolicyParams | Triple, *, deterministic: bool = True) -> Inference:
    """(observations [..., obs], key) -> actions [..., act] in [-1, 1]; pure, to be jitted by the caller.

    A policy that was trained on several observations takes them by name, and reads its own.
    The networks' sizes are read from the parameters. deterministic: the mode of the action's
    distribution instead of a sample; the key is then not used.
    """
    observation_size, action_size, settings = _sizes(params)
    policy = make_inference_fn(make_networks(observation_size, action_size, settings))(
        tuple(params), deterministic=deterministic
    )

    def act(observation: Any, key: jax.Array) -> jax.Array:
        return policy(observation, key)[0]

    return act


def load(content: bytes, *, is_checkpoint: bool, deterministic: bool = True) -> TrainedPolicy:
    """What a checkpoint or a policy file holds, ready to act. Raises JobFailed if it is damaged."""
    params = policy_from_checkpoint(content) if is_checkpoint else read_policy(content)

    def answer(params: PolicyParams, observation: Any, key: jax.Array) -> jax.Array:
        return make_inference(params, deterministic=deterministic)(observation, key)

    def acting(environment: Environment) -> Acting:
        steps = params.config.action_repeat
        if steps == 1:
            return Acting(environment, lambda params, state, key: answer(params, state.obs, key))

        def act(params: PolicyParams, state: State, key: jax.Array) -> jax.Array:
            return ActionHold.due_or_held(state, steps, answer(params, state.obs, key))

        return Acting(ActionHold(environment), act)

    return TrainedPolicy(params, acting)


def policy_from_checkpoint(content: bytes) -> PolicyParams:
    """The policy of a checkpoint, arrays on the host. Raises JobFailed if it is damaged."""
    header, state = FORMAT.read(content)
    template = jax.device_get(init_normalizer(header["observation_size"]))
    normalizer: Any = serialization.from_state_dict(template, state["normalizer"])
    return PolicyParams(
        normalizer, state["params"]["policy"], state["params"]["value"], PolicyConfig.of(header)
    )


def write_policy(params: PolicyParams | Triple) -> bytes:
    """The file that `brax.io.model.load_params` reads: equal parameters give equal bytes.

    A config other than the default follows as JSON, which Brax does not read.
    """
    file = io.BytesIO()
    pickler = _PolicyPickler(file, protocol=4)
    pickler.fast = True  # otherwise the bytes depend on which equal strings are one object
    pickler.dump(jax.tree.map(np.asarray, tuple(params)))  # the map also brings dicts into one order
    if (config := _config(params)) != PolicyConfig():
        file.write(json.dumps(asdict(config)).encode())
    return file.getvalue()


def read_policy(content: bytes) -> PolicyParams:
    """The policy in a file. Of the code that the file names, only that of arrays runs.

    Raises JobFailed("bad_checkpoint") for anything other than a policy.
    """
    try:
        file = io.BytesIO(content)
        normalizer, policy, value = _PolicyUnpickler(file).load()
        rest = file.read()
        config = PolicyConfig.of(json.loads(rest)) if rest else PolicyConfig()
    except Exception as error:  # damaged bytes may make a decoder raise anything
        raise JobFailed(Reason.BAD_CHECKPOINT, "This is not a policy file, or it is damaged.") from error
    return PolicyParams(normalizer, policy, value, config)


class _PolicyPickler(pickle.Pickler):
    def reducer_override(self, obj: Any, /) -> Any:
        # JAX's arrays would be written with private names of the installed JAX.
        if isinstance(obj, jax.Array):
            return np.asarray(obj).__reduce__()
        # Python 3.11.0 to 3.11.3 would write `getattr`, and others the value.
        return (type(obj), (obj.value,)) if isinstance(obj, Enum) else NotImplemented


class _PolicyUnpickler(pickle.Unpickler):
    def find_class(self, module_name: str, global_name: str, /) -> Any:
        if (module_name, global_name) == ("builtins", "getattr"):
            return _member
        if (module_name.replace("numpy.core", "numpy._core"), global_name) not in _ALLOWED:
            raise pickle.UnpicklingError(f"{module_name}.{global_name} does not belong in a policy")
        return super().find_class(module_name, global_name)


def _member(kind: object, name: str) -> Enum:
    """An enumeration's member, as Python 3.11.0 to 3.11.3 writes it."""
    if not (isinstance(kind, type) and issubclass(kind, Enum)):
        raise pickle.UnpicklingError(f"{kind}.{name} does not belong in a policy")
    return kind[name]


def _config(params: PolicyParams | Triple) -> PolicyConfig:
    return params.config if isinstance(params, PolicyParams) else PolicyConfig()


def _sizes(params: PolicyParams | Triple) -> tuple[ObservationSize, int, PPOSpec]:
    """Observation size, action size, and settings with the networks that these parameters were made for."""
    normalizer, policy, value = params
    policy_layers, value_layers = _layers(policy), _layers(value)
    hidden = {
        "policy_hidden_layer_sizes": policy_layers[1:-1],
        "value_hidden_layer_sizes": value_layers[1:-1],
    }
    settings = PPOSpec.model_validate(hidden | asdict(_config(params)))
    sizes: Any = jax.tree.map(lambda mean: mean.shape[-1], normalizer.mean)
    # The last layer gives a location and a scale for each component of an action.
    return sizes, policy_layers[-1] // 2, settings


def _layers(network: Any) -> list[int]:
    """Widths of a network from its input to its output."""
    layers = cast("dict[str, Any]", network["params"])
    kernels = [layers[f"hidden_{i}"]["kernel"] for i in range(len(layers))]
    return [kernels[0].shape[0], *(kernel.shape[1] for kernel in kernels)]
