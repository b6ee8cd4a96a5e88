"""Reads the policy file of a PPO or SAC run: a pickle that Brax reads, too, followed by JSON.

Of the code that the pickle names, only NumPy's code of arrays runs.
"""

import io
import json
import pickle
from typing import Any

from gaitway.errors import PolicyUnreadable

# Everything that a policy file names besides plain containers.
_ARRAYS = {
    ("numpy", "dtype"),
    ("numpy", "ndarray"),
    ("numpy._core.multiarray", "_reconstruct"),
    ("numpy._core.multiarray", "scalar"),
    ("numpy._core.numeric", "_frombuffer"),
}
_RECORDS = {
    ("brax.training.acme.running_statistics", "NormalizationMode"),
    ("brax.training.acme.running_statistics", "RunningStatisticsState"),
    ("brax.training.types", "UInt64"),
}


class _Record:
    """Stands in for Brax's classes: it has the attributes that the file gives it, and no behaviour."""

    def __init__(self, *_: object) -> None: ...


def read(content: bytes) -> tuple[Any, Any, dict[str, Any]]:
    """The normaliser (with `mean` and `std`), the policy network's parameters, and the hyperparameters that
    differ from Brax's defaults. Raises PolicyUnreadable."""
    try:
        file = io.BytesIO(content)
        normalizer, policy, _ = _Unpickler(file).load()
        rest = file.read()
        return normalizer, policy, json.loads(rest) if rest else {}
    except Exception as error:  # damaged bytes may make a decoder raise anything
        raise PolicyUnreadable("This is not a policy file, or it is damaged.") from error


class _Unpickler(pickle.Unpickler):
    def find_class(self, module_name: str, global_name: str, /) -> Any:
        name = (module_name.replace("numpy.core", "numpy._core"), global_name)
        if name in _RECORDS:
            return _Record
        if name in _ARRAYS:
            return super().find_class(*name)
        if name == ("builtins", "getattr"):
            return _member
        raise pickle.UnpicklingError(f"{module_name}.{global_name} does not belong in a policy")


def _member(kind: object, _name: str) -> _Record:
    """A member of an enumeration, as Python 3.11.0 to 3.11.3 writes it."""
    if kind is not _Record:
        raise pickle.UnpicklingError(f"an attribute of {kind} does not belong in a policy")
    return _Record()
