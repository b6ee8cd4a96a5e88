"""What a file says of one clip, before it is known to be one of the body's."""

import lzma
import re
import tokenize
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from core.clips.quaternions import Array
from core.errors import BadClips

# Of one array: 400 MB in memory.
MOST_NUMBERS = 50_000_000
LONGEST_NAME = 200
# U+0000, which no database stores as text, and what UTF-8 cannot encode.
_NO_TEXT = re.compile("[\0\ud800-\udfff]")
# What `zipfile` and NumPy raise for a ZIP that is damaged or encrypted.
DAMAGED_ZIP = (
    zipfile.BadZipFile,
    zipfile.LargeZipFile,
    zlib.error,
    lzma.LZMAError,
    tokenize.TokenError,  # in the header of an array
    EOFError,
    OSError,
    KeyError,
    NotImplementedError,
    RuntimeError,
    ValueError,
)


@dataclass(frozen=True, eq=False)
class Recording:
    """As `Clip`; None where the file does not say.

    joint_positions: [T, J], or [T, 7 + J] with the root's position and orientation in front if root_position
    and root_orientation are None. joints: None means that the file has no names. rate_hint: what to add to
    the sentence that asks for a rate. body_positions: [T, B, 3] m of all bodies, if the file has them.

    Velocities are kept of our own files alone. In those of others, frames and time steps differ within one
    format, and differences of the positions say the same.
    """

    name: str
    joint_positions: Array
    root_position: Array | None = None
    root_orientation: Array | None = None
    joints: tuple[str, ...] | None = None
    rate: float | None = None
    rate_hint: str = ""
    root_linear_velocity: Array | None = None
    root_angular_velocity: Array | None = None
    joint_velocities: Array | None = None
    body_positions: Array | None = None


def at_the_origin(num_frames: int) -> tuple[Array, Array]:
    """Position and orientation of a root that is fixed to the world."""
    return np.zeros((num_frames, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (num_frames, 1))


def numbers(values: Any, name: str, dimensions: Sequence[int] = (2,)) -> Array:
    """The array as float64. Raises BadClips if it holds no numbers, or has another number of dimensions."""
    array = np.asarray(values)
    if array.dtype.kind not in "fiu":
        raise BadClips(f"`{name}` holds {array.dtype}, not numbers.")
    if array.ndim not in dimensions:
        wanted = " or ".join(str(number) for number in dimensions)
        raise BadClips(f"`{name}` has {array.ndim} dimensions, not {wanted}.")
    if array.size > MOST_NUMBERS:
        raise BadClips(f"`{name}` has {array.size:,} numbers; at most {MOST_NUMBERS:,} are read.")
    return array.astype(np.float64)


def number(values: Any, name: str) -> float:
    """The one number of an array. Raises BadClips."""
    array = np.asarray(values)
    if array.dtype.kind not in "fiu" or array.size != 1:
        raise BadClips(f"`{name}` is not one number.")
    return float(array.reshape(()))


def check_text(text: str) -> None:
    """Refuse a name that no record can hold. Raises BadClips."""
    if _NO_TEXT.search(text):
        raise BadClips(f"The name {text[:40]!r} has the character U+0000, or one that UTF-8 cannot encode.")


def strings(values: Any, name: str) -> tuple[str, ...]:
    """Texts, or bytes in UTF-8. Raises BadClips."""
    array = np.asarray(values)
    if array.ndim != 1 or not all(isinstance(value, str | bytes) for value in array.tolist()):
        raise BadClips(f"`{name}` is not a list of names.")
    try:
        found = [value.decode() if isinstance(value, bytes) else value for value in array.tolist()]
    except UnicodeDecodeError:
        raise BadClips(f"`{name}` has names that are not UTF-8.") from None
    return tuple(text[:LONGEST_NAME] for text in found)
