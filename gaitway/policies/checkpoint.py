"""Reads the files that `core.algorithms.checkpoint` writes: MessagePack of {"header", "sha256", "state"}.

Arrays are Flax's MessagePack extension (`flax.serialization`). Nothing in a file is executed.
"""

import hashlib
from typing import Any

import msgpack
import numpy as np

from gaitway.errors import PolicyUnreadable

_ARRAY, _SCALAR = 1, 3  # Flax's numbers for its extension types


def read(content: bytes, wanted: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """The header and the state, nested dicts of arrays. wanted: the format that the header must name.

    Raises PolicyUnreadable.
    """
    try:
        parts = _decode(content)
        header, body = parts["header"], parts["state"]
        found, is_intact = header["format"], hashlib.sha256(body).hexdigest() == parts["sha256"]
    except Exception as error:  # damaged bytes may make a decoder raise anything
        raise PolicyUnreadable("This is not a file of this service, or it is damaged.") from error
    if found != wanted:
        raise PolicyUnreadable(
            f"The file has the format {found!r}; this version of gaitway reads {wanted!r}."
        )
    if not is_intact:
        raise PolicyUnreadable("The file is damaged: its content does not have the recorded SHA-256.")
    return header, _decode(body)


def _decode(content: bytes) -> dict[str, Any]:
    return msgpack.unpackb(content, ext_hook=_extension, object_hook=_joined)


def _extension(code: int, data: bytes) -> Any:
    if code not in (_ARRAY, _SCALAR):
        raise ValueError(f"extension type {code}")
    shape, dtype, buffer = msgpack.unpackb(data)
    array = np.frombuffer(buffer, np.dtype(dtype)).reshape(shape)
    return array if code == _ARRAY else array[()]


def _joined(tree: dict[str, Any]) -> Any:
    """An array of more than 1 GiB, which Flax writes in parts; everything else as it is."""
    if "__msgpack_chunked_array__" not in tree:
        return tree
    parts, shape = ([tree[name][str(i)] for i in range(len(tree[name]))] for name in ("chunks", "shape"))
    return np.concatenate(parts).reshape(shape)
