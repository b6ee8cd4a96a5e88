"""The file of a network's policy, which Brax reads, too."""

import io
import json
import pickle
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from enum import Enum
from typing import Any

import jax
import numpy as np
from flax import struct

from core.algorithms import brax_pickle
from core.algorithms.brax_training import RunningStatisticsState, UInt64, running_statistics
from core.errors import JobFailed
from core.reasons import Reason

# (normaliser, policy, value), with the default config
Triple = tuple[Any, Any, Any]


@dataclass(frozen=True)
class PolicyConfig:
    """The hyperparameters of these names, which inference needs besides a policy's parameters.

    encoder_places: (start, size) of what an encoder sees of the observation; None: there is no encoder.
    """

    activation: str = "swish"
    policy_obs_key: str = "state"
    value_obs_key: str = "state"
    action_repeat: int = 1
    normalize_observations_max_abs_value: float | None = None
    encoder_places: tuple[tuple[int, int], ...] | None = None

    @classmethod
    def of(cls, facts: Mapping[str, Any]) -> "PolicyConfig":
        """From facts that may include others; a missing one takes its default.

        A run that does not normalise observations does not bound them either.
        """
        names = set(asdict(cls())) & facts.keys()
        if not facts.get("normalize_observations", True):
            names -= {"normalize_observations_max_abs_value"}
        values = {name: facts[name] for name in names}
        if places := values.get("encoder_places"):
            values["encoder_places"] = tuple((int(start), int(size)) for start, size in places)
        return cls(**values)


@struct.dataclass
class PolicyParams:
    """Brax's saved parameters, which its inference functions take: (normaliser, policy, value), and a config.

    Iterates like that triple; a bare triple can replace it if the config is the default.
    """

    normalizer: RunningStatisticsState
    policy: Any
    value: Any
    config: PolicyConfig = struct.field(pytree_node=False, default=PolicyConfig())

    def __iter__(self) -> Iterator[Any]:
        return iter((self.normalizer, self.policy, self.value))


def write_policy(params: PolicyParams | Triple) -> bytes:
    """The file that `brax.io.model.load_params` reads: equal parameters give equal bytes.

    A config other than the default follows as JSON, which Brax does not read.
    """
    file = io.BytesIO()
    pickler = _PolicyPickler(file, protocol=4)
    pickler.fast = True  # otherwise the bytes depend on which equal strings are one object
    pickler.dump(jax.tree.map(np.asarray, tuple(params)))  # the map also brings dicts into one order
    if (config := config_of(params)) != PolicyConfig():
        file.write(json.dumps(asdict(config)).encode())
    return file.getvalue()


def read_policy(content: bytes) -> PolicyParams:
    """The policy in a file, whoever wrote it: the file is read as data, and nothing that it names is called.

    Raises JobFailed("bad_checkpoint") for anything other than a policy.
    """
    try:
        (normalizer, policy, value), rest = brax_pickle.read(content)
        config = PolicyConfig.of(json.loads(rest)) if rest else PolicyConfig()
        params = PolicyParams(_normalizer(normalizer), policy, value, config)
        _check(params)
    except Exception as error:  # damaged bytes may make a decoder raise anything
        raise JobFailed(Reason.BAD_CHECKPOINT, "This is not a policy file, or it is damaged.") from error
    return params


def _normalizer(fields: Mapping[str, Any]) -> RunningStatisticsState:
    """Brax's own record; older files lack some fields, and count in one number."""
    count, mode = fields["count"], fields.get("mode", 0)
    kinds = running_statistics.NormalizationMode
    read: dict[str, Any] = {
        "count": UInt64(**count) if isinstance(count, dict) else count,
        "mode": kinds[mode] if isinstance(mode, str) else kinds(mode),
    }
    return RunningStatisticsState(**{**fields, **read})


def _check(params: PolicyParams) -> None:
    """Raises an exception of some kind where the parts do not make a network with its normaliser."""
    config = params.config
    means: Any = params.normalizer.mean
    deviations: Any = params.normalizer.std
    if isinstance(means, dict):
        means, deviations = means[config.policy_obs_key], deviations[config.policy_obs_key]
    if config.encoder_places is None:
        _check_network(params.policy, means.shape[0])
    else:
        _check_encoder(params.policy, means.shape[0], config.encoder_places)
    if params.value:  # SAC's files have none.
        _check_network(params.value)
    if means.shape != deviations.shape or means.ndim != 1:
        raise ValueError("the normaliser is for other observations")


def _check_encoder(network: Any, width: int, places: Sequence[tuple[int, int]]) -> None:
    """width: of the observation; places: what the encoder sees of it."""
    encoder, decoder = ({"params": network["params"][name]} for name in ("encoder", "decoder"))
    seen = sum(size for _, size in places)
    if any(start + size > width for start, size in places):
        raise ValueError("the encoder's places go beyond the observation")
    _check_network(encoder, seen)
    latent = encoder["params"][f"hidden_{len(encoder['params']) - 1}"]["bias"].shape[0] // 2
    _check_network(decoder, latent + width - seen)


def _check_network(network: Any, width: int | None = None) -> None:
    layers = network["params"]
    for i in range(sum(name.startswith("hidden_") for name in layers)):  # An export names other parts.
        kernel, bias = layers[f"hidden_{i}"]["kernel"], layers[f"hidden_{i}"]["bias"]
        if kernel.ndim != 2 or bias.shape != kernel.shape[1:] or width not in (None, kernel.shape[0]):
            raise ValueError(f"layer {i} does not fit the one before")
        width = kernel.shape[1]


def config_of(params: PolicyParams | Triple) -> PolicyConfig:
    """A bare triple's is the default."""
    return params.config if isinstance(params, PolicyParams) else PolicyConfig()


class _PolicyPickler(pickle.Pickler):
    def reducer_override(self, obj: Any, /) -> Any:
        # JAX's arrays would be written with private names of the installed JAX.
        if isinstance(obj, jax.Array):
            return np.asarray(obj).__reduce__()
        # Python 3.11.0 to 3.11.3 would write `getattr`, and others the value.
        return (type(obj), (obj.value,)) if isinstance(obj, Enum) else NotImplemented
