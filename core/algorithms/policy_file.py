"""The file of a network's policy, which Brax reads, too."""

import io
import json
import pickle
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from enum import Enum
from typing import Any

import jax
import numpy as np
from flax import struct

from core.algorithms.brax_training import RunningStatisticsState
from core.errors import JobFailed
from core.reasons import Reason

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


@dataclass(frozen=True)
class PolicyConfig:
    """What inference needs besides a policy's parameters: the hyperparameters of these names."""

    activation: str = "swish"
    policy_obs_key: str = "state"
    value_obs_key: str = "state"
    action_repeat: int = 1
    normalize_observations_max_abs_value: float | None = None

    @classmethod
    def of(cls, facts: Mapping[str, Any]) -> "PolicyConfig":
        """From facts that may include others; a missing one takes its default.

        A run that does not normalise observations does not bound them either.
        """
        names = set(asdict(cls())) & facts.keys()
        if not facts.get("normalize_observations", True):
            names -= {"normalize_observations_max_abs_value"}
        return cls(**{name: facts[name] for name in names})


@struct.dataclass
class PolicyParams:
    """What Brax saves and its inference functions take, (normaliser, policy, value), and their config.

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
