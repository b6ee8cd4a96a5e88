"""HDF5 without its ways out of the file: links and data that lie in others are as if they were not there."""

from collections.abc import Generator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py

from core.clips.formats.recording import MOST_NUMBERS
from core.errors import BadClips

MAGIC = b"\x89HDF\r\n\x1a\n"
MOST_MEMBERS = 100_000
# What h5py raises for damage, by where it lies.
_DAMAGED = (OSError, RuntimeError, KeyError, TypeError, ValueError)


@contextmanager
def opened(path: Path) -> Generator[Any]:
    """The file's root group. Raises BadClips if it is damaged."""
    try:
        file = h5py.File(path, "r")
    except _DAMAGED as error:
        raise BadClips(f"The HDF5 file is not whole: {error}.") from None
    with file:
        try:
            yield file
        except _DAMAGED as error:
            raise BadClips(f"The HDF5 file is damaged: {error}.") from None


def members(group: Any) -> Mapping[str, Any]:
    """Groups and arrays that lie in this group itself, by name. Raises BadClips for too many, and for what is
    no group."""
    if is_array(group):
        raise BadClips(f"`{group.name}` is an array, not a group.")
    if len(group) > MOST_MEMBERS:
        raise BadClips(f"The HDF5 file has {len(group):,} members; at most {MOST_MEMBERS:,} are read.")
    found: dict[str, Any] = {}
    for name in group:
        if isinstance(group.get(name, getlink=True), h5py.HardLink):
            member = group[name]
            if not (is_array(member) and (member.external or member.is_virtual)):
                found[name] = member
    return found


def is_array(member: Any) -> bool:
    return isinstance(member, h5py.Dataset)


def read(member: Any, name: str) -> Any:
    """An array's values. Raises BadClips if it is a group, or too large."""
    if not is_array(member):
        raise BadClips(f"`{name}` is a group, not an array.")
    if member.size is not None and member.size > MOST_NUMBERS:
        raise BadClips(f"`{name}` has {member.size:,} numbers; at most {MOST_NUMBERS:,} are read.")
    return member[()]
