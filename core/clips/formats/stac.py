"""HDF5 of stac-mjx, which has `qpos` and names, and of track-mjx, which has parts of it (`ReferenceClip`)."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

from core.clips.formats import hdf5
from core.clips.formats.recording import Recording, at_the_origin, numbers, strings
from core.clips.quaternions import Array
from core.errors import BadClips

NAME = "stac-mjx"
_PARTS = ("position", "quaternion", "joints")
_TRACK_MJX = "Those of track-mjx's rat have 50."


def is_one(file: Mapping[str, Any]) -> bool:
    return _is_clip(file) or any(_is_clip(member) for member in file.values() if not hdf5.is_array(member))


def recordings(file: Mapping[str, Any]) -> list[Recording]:
    """Clips of `qpos` in the root or in groups, cut as the configuration in the file says; or of `position`,
    `quaternion` and `joints` [T, …] or [clips, T, …]. Raises BadClips."""
    if _is_clip(file):
        return _of_group("", file, file)
    groups = [
        (name, member) for name, member in file.items() if not hdf5.is_array(member) and _is_clip(member)
    ]
    return [clip for name, group in groups for clip in _of_group(name, hdf5.members(group), file)]


def _is_clip(group: Any) -> bool:
    return "qpos" in group or all(part in group for part in _PARTS)


def _of_group(name: str, group: Mapping[str, Any], file: Mapping[str, Any]) -> list[Recording]:
    if "qpos" in group:
        return _of_qpos(name, group, file)
    parts = [numbers(hdf5.read(group[part], part), part, (2, 3)) for part in _PARTS]
    if len({part.ndim for part in parts}) > 1:
        raise BadClips("`position`, `quaternion` and `joints` do not have the same number of dimensions.")
    if parts[0].ndim == 2:
        return [_recording(name, *parts)]
    if len({len(part) for part in parts}) > 1:
        raise BadClips("`position`, `quaternion` and `joints` do not have the same number of clips.")
    return [_recording(_numbered(name, i), *rows) for i, rows in enumerate(zip(*parts, strict=True))]


def _of_qpos(name: str, group: Mapping[str, Any], file: Mapping[str, Any]) -> list[Recording]:
    rows = numbers(hdf5.read(group["qpos"], "qpos"), "qpos", (2, 3))
    config = _text({**file, **group}.get("config"))
    named = group.get("names_qpos", file.get("names_qpos"))
    names = None if named is None else strings(hdf5.read(named, "names_qpos"), "names_qpos")
    hint = _rate_hint(config)
    pieces = list(rows) if rows.ndim == 3 else _cut(rows, _setting(config, "n_frames_per_clip"))
    labels = [name] if len(pieces) == 1 else [_numbered(name, i) for i in range(len(pieces))]
    return [_of_rows(label, piece, names, hint) for label, piece in zip(labels, pieces, strict=True)]


def _of_rows(name: str, rows: Array, names: Sequence[str] | None, hint: str) -> Recording:
    if names is None:
        return Recording(name=name, joint_positions=rows, rate_hint=hint)
    width = rows.shape[1]
    # The root's name stands once, or once for each of its seven numbers, or there is none.
    seven = len(set(names[:7])) == 1 and len(names) == width and width > 7
    once = len(names) == width - 6
    if not (seven or once or len(names) == width):
        raise BadClips(f"`qpos` has {width} columns, but `names_qpos` has {len(names)} names.")
    if not (seven or once):
        return Recording(name, rows, *at_the_origin(len(rows)), tuple(names), rate_hint=hint)
    joints = tuple(names[7:] if seven else names[1:])
    return Recording(name, rows[:, 7:], rows[:, :3], rows[:, 3:7], joints, rate_hint=hint)


def _recording(name: str, position: Array, quaternion: Array, joints: Array) -> Recording:
    return Recording(name, joints, position, quaternion, rate_hint=_TRACK_MJX)


def _cut(rows: Array, length: float | None) -> list[Array]:
    frames = int(length or 0)
    if frames < 2 or len(rows) % frames:
        return [rows]
    return list(rows.reshape(-1, frames, rows.shape[1]))


def _numbered(name: str, number: int) -> str:
    return f"{name or 'clip'}_{number}"


def _text(member: Any) -> str:
    """The configuration, YAML text; empty if there is none."""
    if member is None or not hdf5.is_array(member):
        return ""
    value = hdf5.read(member, "config")
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)


def _setting(config: str, name: str) -> float | None:
    """A number in the text, whichever section it is in."""
    found = re.search(rf"^\s*{name}:\s*(\d{{1,9}}(?:\.\d*)?)\s*$", config, re.MULTILINE)
    return None if found is None else float(found[1])


def _rate_hint(config: str) -> str:
    found = _setting(config, "RENDER_FPS")
    return "" if found is None else f"Its configuration draws {found:g} a second, which is likely the rate."
