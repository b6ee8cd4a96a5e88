"""A file of clips in any known format, told by its content, as clips of a body."""

import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from core.clips import archive, key_points
from core.clips.check import check, numeric_problems
from core.clips.clip import Clip, arrays, with_velocities
from core.clips.formats import hdf5, lafan, mjlab, mocap, stac, trajectories
from core.clips.formats import key_points as points_of
from core.clips.formats.key_points import KeyPoints
from core.clips.formats.recording import (
    DAMAGED_ZIP,
    LONGEST_NAME,
    MOST_NUMBERS,
    Recording,
    at_the_origin,
    check_text,
)
from core.clips.kinematics import poses, qpos
from core.clips.quaternions import Array
from core.clips.record import KeyPointFacts
from core.clips.skeleton import Skeleton, aligned, skeleton_of
from core.errors import BadClips

MOST_CLIPS = 10_000
_HIGHEST_RATE = 10_000
_NPZ_MAGIC = b"PK\x03\x04"
_LARGEST_NPZ_BYTES = 8 * MOST_NUMBERS
_MOST_PROBLEMS = 5
_FORMATS = (
    "NPZ of mjlab or BeyondMimic (`joint_pos`), of our trajectories or of our clips; HDF5 of stac-mjx "
    "(`qpos`), track-mjx (`position`, `quaternion`, `joints`) or dm_control (`walkers`); CSV like LAFAN1's; "
    "and key points (`key_points`, `tracks`, `pred`) in NPZ, HDF5, NWB, MATLAB or CSV"
)


@dataclass(frozen=True)
class Reading:
    """The clips of a file, whose joints are the model's in its order, with velocities; what may be wrong with
    each, one list a clip; the file's format; and how well a recording of key points fits."""

    format: str
    clips: Sequence[Clip]
    warnings: Sequence[Sequence[str]]
    key_points: Sequence[KeyPointFacts] = ()


def read(  # All but the file and the body are named.
    path: Path,
    model: mujoco.MjModel,
    *,
    rate: float | None = None,
    name: str = "clip",
    allow: Callable[[int], object] = lambda seconds: None,
    begin: Callable[[int, int], object] = lambda frame, num_frames: None,
) -> Reading:
    """The clips of the file, checked.

    rate: frames per second, for a file that does not say. name: of the clip of a file that has one, and no
    name for it. allow: is told the seconds of processor time that key points may take, before they are
    solved. begin: as of `inverse_kinematics.solve`. Raises BadClips with what is wrong, clip by clip; nothing
    of such a file can be used.
    """
    skeleton = skeleton_of(model)
    path, options = key_points.unpacked(path)
    format, found = _recordings(path, skeleton.joints if options is None else ())
    if isinstance(found, KeyPoints):
        options = options or key_points.KeyPointOptions.model_validate({})
        rate = _rate(found, rate)
        allow(key_points.seconds_for(found, options, model))
        solved = key_points.solved(found, options, model, rate=rate, name=name, begin=begin)
        clip = with_velocities(solved.clip)
        if wrong := numeric_problems(clip):
            raise BadClips(" ".join(wrong))
        # The poses are estimates: what is wrong with some, as a tail that no point shows, is told alone.
        findings = check(clip, skeleton)
        warnings = [*solved.warnings, *findings.problems, *findings.warnings]
        return Reading(format, [clip], [warnings], solved.key_points)
    if options is not None:
        raise BadClips(f"`{key_points.OPTIONS}` is for key points, and the file beside it is of {format}.")
    if not found:
        raise BadClips("The file has no clips.")
    if len(found) > MOST_CLIPS:
        raise BadClips(f"The file has {len(found):,} clips; at most {MOST_CLIPS:,} are read.")
    clips: list[Clip] = []
    told: list[list[str]] = []
    problems: list[str] = []
    for recording, label in zip(found, _labels(found, name), strict=True):
        clip = _clip(replace(recording, name=label), skeleton, rate)
        wrong = numeric_problems(clip)
        if not wrong:
            clip = with_velocities(_with_unit_quaternions(clip))
            findings = check(clip, skeleton)
            wrong = findings.problems
            told.append(findings.warnings)
        clips.append(clip)
        problems += wrong if len(found) == 1 else [f"{label}: {sentence}" for sentence in wrong]
        if len(problems) >= _MOST_PROBLEMS:
            break
    if problems:
        raise BadClips(" ".join(problems[:_MOST_PROBLEMS]))
    return Reading(format, clips, told)


def _recordings(path: Path, joints: Sequence[str]) -> tuple[str, list[Recording] | KeyPoints]:
    """The file's format, and what it holds. joints: columns of a CSV that are called so are joints, and no
    coordinates of key points."""
    with path.open("rb") as file:
        start = file.read(len(points_of.MATLAB_HDF5))
    if start.startswith(_NPZ_MAGIC):
        return _of_npz(path)
    if start.startswith(hdf5.MAGIC) or start == points_of.MATLAB_HDF5:
        return _of_hdf5(path, is_matlabs=start == points_of.MATLAB_HDF5)
    if start.startswith(points_of.MATLAB):
        if (found := points_of.of_matlab(path)) is not None:
            return points_of.NAME, found
        raise BadClips("The MATLAB file has neither `pred` nor `key_points`.")
    if start.startswith(b"\x93NUMPY"):
        raise BadClips("The file is a single NumPy array (.npy), without names or a rate: send NPZ or CSV.")
    if start.startswith(b"\x80"):
        raise BadClips(
            "The file is pickled Python, which is not read: it could run anything. Send NPZ or HDF5."
        )
    if not start:
        raise BadClips("The file is empty.")
    if (found := points_of.of_text(path, joints)) is not None:
        return points_of.NAME, found
    return lafan.NAME, lafan.recordings(path)


def _of_npz(path: Path) -> tuple[str, list[Recording] | KeyPoints]:
    try:
        with zipfile.ZipFile(path) as packed:
            size = sum(member.file_size for member in packed.infolist())
        if size > _LARGEST_NPZ_BYTES:
            raise BadClips(f"The file has {size:,} bytes unpacked; at most {_LARGEST_NPZ_BYTES:,} are read.")
        with np.load(path, allow_pickle=False) as file:
            names = set(file.files)
            about = trajectories.about_of(file, names)
            if about.get("format") == archive.FORMAT:
                return archive.FORMAT, [_of_our_own(clip) for clip in archive.from_file(path)]
            if trajectories.is_one(about):
                return trajectories.NAME, trajectories.recordings(file, about)
            if mjlab.is_one(names):
                return mjlab.NAME, mjlab.recordings(file, names)
            if (found := points_of.of_arrays(file)) is not None:
                return points_of.NAME, found
    except ValueError as error:
        if "allow_pickle" in str(error):
            detail = (
                "An array of the file holds pickled objects, which are not read: they could run anything."
            )
            raise BadClips(detail) from None
        raise BadClips(f"The NPZ file cannot be read: {error}.") from None
    except DAMAGED_ZIP as error:
        raise BadClips(f"The NPZ file is not whole: {error}.") from None
    raise BadClips(f"The NPZ file has {_some(names)}, which is no known format. Known are {_FORMATS}.")


def _of_hdf5(path: Path, *, is_matlabs: bool) -> tuple[str, list[Recording] | KeyPoints]:
    with hdf5.opened(path) as root:
        file = hdf5.members(root)
        if stac.is_one(file):
            return stac.NAME, stac.recordings(file)
        if mocap.is_one(file):
            return mocap.NAME, mocap.recordings(file)
        found = points_of.of_nwb(file) or points_of.of_arrays(file, is_matlabs=is_matlabs)
        if found is not None:
            return points_of.NAME, found
        raise BadClips(f"The HDF5 file has {_some(file)}, which is no known format. Known are {_FORMATS}.")


def _of_our_own(clip: Clip) -> Recording:
    values: dict[str, Any] = dict(arrays(clip))
    return Recording(name=clip.name, rate=clip.rate, joints=clip.joints, **values)


def _some(names: Mapping[str, Any] | set[str]) -> str:
    found = sorted(names)
    return ", ".join(f"`{name[:40]}`" for name in found[:8]) or "nothing"


def _labels(recordings: Sequence[Recording], name: str) -> Iterator[str]:
    """Names of which no two are the same."""
    used = dict[str, int]()
    for recording in recordings:
        label = plain = (recording.name or name)[:LONGEST_NAME]
        check_text(label)
        while label in used:
            used[plain] += 1
            label = f"{plain}_{used[plain]}"
        used[label] = 1
        yield label


def _clip(recording: Recording, skeleton: Skeleton, rate: float | None) -> Clip:
    """The recording as one of the body. Raises BadClips."""
    recording = _with_root(recording, skeleton)
    values = {
        name: getattr(recording, name)
        for name in (
            "root_position",
            "root_orientation",
            "joint_positions",
            "root_linear_velocity",
            "root_angular_velocity",
            "joint_velocities",
        )
    }
    orders = [recording.joints] if recording.joints is not None else _orders(recording, skeleton)
    facts: dict[str, Any] = {"name": recording.name, "rate": _rate(recording, rate)}
    try:
        candidates = [aligned(Clip(**facts, joints=joints, **values), skeleton) for joints in orders]
    except ValueError as error:
        raise BadClips(str(error)) from None
    if len(candidates) == 1 or recording.body_positions is None:
        return candidates[0]
    places = recording.body_positions
    return min(candidates, key=lambda clip: _distance(clip, places, skeleton))


def _with_root(recording: Recording, skeleton: Skeleton) -> Recording:
    """The recording with its root apart from its joints. Raises BadClips if columns and joints do not fit."""
    num_joints = len(skeleton.joints if recording.joints is None else recording.joints)
    rows = recording.joint_positions
    if recording.root_position is None:
        if skeleton.root_joint is None and rows.shape[1] == num_joints:
            position, orientation = at_the_origin(len(rows))
            return replace(recording, root_position=position, root_orientation=orientation)
        if rows.shape[1] != num_joints + 7:
            raise BadClips(
                f"The clip {recording.name!r} has {rows.shape[1]} columns; its {num_joints} joints with the "
                f"root's position and orientation take {num_joints + 7}."
            )
        return replace(
            recording,
            root_position=rows[:, :3],
            root_orientation=rows[:, 3:7],
            joint_positions=rows[:, 7:],
        )
    if recording.joints is None and rows.shape[1] == num_joints + 7:
        return replace(
            recording, joint_positions=rows[:, 7:], root_position=rows[:, :3], root_orientation=rows[:, 3:7]
        )
    if recording.joints is None and rows.shape[1] != num_joints:
        raise BadClips(
            f"The clip {recording.name!r} is of another body: it has {rows.shape[1]} joints, without names, "
            f"and the body has {num_joints}."
        )
    return recording


def _rate(recording: Recording | KeyPoints, rate: float | None) -> float:
    """Frames per second. Raises BadClips if neither the file nor its sender says, if they disagree, and for a
    rate that no recording has."""
    if recording.rate is None:
        if rate is None:
            hint = (
                f" {recording.rate_hint}" if isinstance(recording, Recording) and recording.rate_hint else ""
            )
            raise BadClips(f"The file does not say how many frames a second it has: give `rate`.{hint}")
        return rate
    if not 0 < recording.rate <= _HIGHEST_RATE:
        raise BadClips(
            f"The file says that it has {recording.rate:g} frames a second: it must be more than 0 and at "
            f"most {_HIGHEST_RATE:,}."
        )
    if rate is not None and abs(rate - recording.rate) > 0.001 * rate:
        raise BadClips(f"The file says that it has {recording.rate:g} frames a second, and `rate` {rate:g}.")
    return recording.rate


def _orders(recording: Recording, skeleton: Skeleton) -> list[tuple[str, ...]]:
    """What joints without names may be: the model's in its order, or by depth, as Isaac Lab has them."""
    if recording.body_positions is None or recording.body_positions.shape[0] != len(
        recording.joint_positions
    ):
        return [skeleton.joints]
    return [skeleton.joints, skeleton.joints_by_depth]


def _distance(clip: Clip, places: Array, skeleton: Skeleton) -> float:
    """How far the body's bodies are from the root beside those in the file, in m, over some frames.

    Each is compared with the one whose distance is nearest: the file may have others, in any order.
    """
    frames = np.unique(np.linspace(0, clip.num_frames - 1, 20).astype(int))
    at = poses(qpos(clip, skeleton)[frames], skeleton.model).body_positions[:, skeleton.bodies]
    ours = np.linalg.norm(at - clip.root_position[frames, None], axis=-1)
    theirs = np.linalg.norm(places[frames] - clip.root_position[frames, None], axis=-1)
    return float(np.abs(ours[:, :, None] - theirs[:, None]).min(axis=-1).mean())


def _with_unit_quaternions(clip: Clip) -> Clip:
    lengths = np.linalg.norm(clip.root_orientation, axis=-1, keepdims=True)
    return replace(clip, root_orientation=clip.root_orientation / lengths)
