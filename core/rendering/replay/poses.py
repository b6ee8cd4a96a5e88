"""An episode as the poses of bodies: what the model's kinematics make of its positions."""

import copy
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from core.rendering.replay.scene_file import parts
from core.rendering.scene import TARGET_BODY
from core.rendering.timeline import EpisodeMotion, Floats

# Viewers interpolate between frames: more would only cost bytes.
_FRAMES_PER_SECOND = 60
# Whole numbers of 16 bits, from -1 to 1.
_UNITS = 32767
# What MuJoCo has in place of a point where a tendon divides.
_PULLEY = -2


@dataclass(frozen=True)
class EpisodePoses:
    """N frames of M bodies. arrays: by name, as `docs/replay.md` lists them; scale_m: what 32767 means in
    `position`, `contact_position` and `reference_position`, in metres. parts: nodes that are elsewhere, or of
    another size, in this episode.
    """

    arrays: dict[str, NDArray[Any]]
    scale_m: float
    parts: list[dict[str, Any]]


@dataclass(frozen=True)
class _PoseFrame:
    """position [M, 3], rotation [M, 4]; contacts [C, 6]: points and normals; segments [S, 2, 3] of the
    tendons numbered in `tendons` [S]. reference: position and rotation of the bodies that follow a clip."""

    position: Floats
    rotation: Floats
    contacts: Floats
    segments: Floats
    tendons: NDArray[np.int64]
    target: Floats | None
    reference: tuple[Floats, Floats] | None


def moving_bodies(model: mujoco.MjModel) -> list[int]:
    """The bodies that positions can move; not that of the target, which has an array of its own."""
    target = target_body(model)
    return [body for body in range(1, model.nbody) if model.body_weldid[body] != 0 and body != target]


def target_body(model: mujoco.MjModel) -> int | None:
    """The body that marks an episode's target, if the model has one; not if joints move it."""
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, TARGET_BODY)
    is_mark = number > 0 and model.body_parentid[number] == 0 and model.body_weldid[number] == 0
    return number if is_mark else None


def followed_bodies(model: mujoco.MjModel, tracked_body: int) -> list[int]:
    """The moving bodies of the tracked one's tree: a clip is of these."""
    root = model.body_rootid[tracked_body]
    return [body for body in moving_bodies(model) if model.body_rootid[body] == root]


def poses(model: mujoco.MjModel, motion: EpisodeMotion, followed: Sequence[int] = ()) -> EpisodePoses:
    """The poses of an episode, at most some 60 frames a second, the last state among them. followed: the
    bodies whose poses are kept as its reference has them, if it has one."""
    rows = frame_rows(motion.time)
    frames = list(_frames(model, motion, rows, list(followed)))
    arrays, scale_m = _packed(motion.time[rows] - motion.time[0], frames)
    if motion.velocities is not None:
        told, measured = np.moveaxis(motion.velocities[rows], 1, 0).astype(np.float32)
        arrays |= {"command": told, "velocity": measured}
    return EpisodePoses(arrays, scale_m, parts=_changed_parts(model, motion))


def frame_rows(time: Floats) -> NDArray[np.int64]:
    """The rows of an episode's states that become frames. time: [T+1] in s."""
    steps = max(1, len(time) - 1)
    stride = max(1, round(steps / _FRAMES_PER_SECOND / max(float(time[-1] - time[0]), 1e-9)))
    rows = np.arange(0, len(time), stride)
    return rows if rows[-1] == len(time) - 1 else np.append(rows, len(time) - 1)


def _frames(
    model: mujoco.MjModel, motion: EpisodeMotion, rows: NDArray[np.int64], followed: list[int]
) -> Iterator[_PoseFrame]:
    model = copy.copy(model)
    for name, values in motion.model.items():
        getattr(model, name)[:] = values
    data, clip = mujoco.MjData(model), mujoco.MjData(model)
    bodies, mark = moving_bodies(model), target_body(model)
    for row in rows:
        target: Floats | None = None
        if motion.target is not None:
            given = motion.target[row]
            target = np.append(given, 0.0)[:3]
            if mark is not None:
                model.body_pos[mark, : len(given)] = given
        data.qpos[:] = motion.qpos[row]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_tendon(model, data)
        mujoco.mj_collision(model, data)
        if target is not None and mark is not None:
            target = data.xpos[mark].copy()
        reference = None
        if motion.reference is not None and followed:
            clip.qpos[:] = motion.reference[row]
            mujoco.mj_kinematics(model, clip)
            reference = clip.xpos[followed], clip.xquat[followed]
        own = data.xpos[bodies], data.xquat[bodies]
        yield _PoseFrame(*own, _contacts(data), *_tendons(model, data), target, reference)


def _contacts(data: mujoco.MjData) -> Floats:
    """[C, 6]: where bodies touch, and the directions in which they push each other."""
    found = data.contact
    touches = found.exclude == 0
    return np.concatenate([found.pos[touches], found.frame[touches, :3]], axis=1)


def _tendons(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[Floats, NDArray[np.int64]]:
    """The straight parts [S, 2, 3] of the spatial tendons that are seen, and the tendon of each [S]."""
    segments: list[Floats] = []
    owners: list[int] = []
    points, objects = data.wrap_xpos.reshape(-1, 3), data.wrap_obj.ravel()
    for tendon in range(model.ntendon):
        first, number = int(data.ten_wrapadr[tendon]), int(data.ten_wrapnum[tendon])
        if model.tendon_group[tendon] >= 3 or model.tendon_rgba[tendon, 3] == 0:
            continue
        for point in range(first, first + number - 1):
            if objects[point] != _PULLEY and objects[point + 1] != _PULLEY:
                segments.append(points[point : point + 2].copy())
                owners.append(tendon)
    return np.array(segments, float).reshape(-1, 2, 3), np.array(owners, np.int64)


def _packed(time: Floats, frames: list[_PoseFrame]) -> tuple[dict[str, NDArray[Any]], float]:
    """The arrays of the file, and the scale of those that hold positions."""
    num_bodies = len(frames[0].position)
    origin = np.array([one.position[0] if num_bodies else np.zeros(3) for one in frames])
    position = np.array([one.position for one in frames]) - origin[:, None]
    contacts = np.concatenate([one.contacts for one in frames])
    contact_count = np.array([len(one.contacts) for one in frames])
    touched = contacts[:, :3] - np.repeat(origin, contact_count, axis=0)
    clip = [one.reference for one in frames if one.reference is not None]
    clip_position = np.array([places for places, _ in clip])
    clip_origin = clip_position[:, 0] if clip else clip_position
    clip_position = clip_position - clip_origin[:, None] if clip else clip_position
    shown = (position, touched, clip_position)
    scale = max(float(np.abs(values).max(initial=0.0)) for values in shown) or 1.0
    arrays: dict[str, NDArray[Any]] = {
        "time": time.astype(np.float32),
        "origin": origin.astype(np.float32),
        "position": _units(position / scale),
        "rotation": _units(np.array([one.rotation for one in frames])),
        "contact_count": contact_count.astype(np.uint16),
        "contact_position": _units(touched / scale),
        "contact_normal": _units(contacts[:, 3:]),
    }
    if frames[0].target is not None:
        arrays["target"] = np.array([one.target for one in frames], np.float32)
    if clip:
        arrays["reference_origin"] = clip_origin.astype(np.float32)
        arrays["reference_position"] = _units(clip_position / scale)
        arrays["reference_rotation"] = _units(np.array([turns for _, turns in clip]))
    if any(len(one.tendons) for one in frames):
        arrays["tendon_count"] = np.array([len(one.tendons) for one in frames], np.uint16)
        arrays["tendon_segment"] = np.concatenate([one.segments for one in frames]).astype(np.float32)
        arrays["tendon"] = np.concatenate([one.tendons for one in frames]).astype(np.uint16)
    return arrays, scale


def _units(values: Floats) -> NDArray[np.int16]:
    return np.round(_UNITS * np.clip(values, -1.0, 1.0)).astype(np.int16)


def _changed_parts(model: mujoco.MjModel, motion: EpisodeMotion) -> list[dict[str, Any]]:
    """The nodes of geoms that are elsewhere, or of another size, in this episode, and how."""
    positions = motion.model.get("geom_pos", model.geom_pos)
    sizes = motion.model.get("geom_size", model.geom_size)
    turns = motion.model.get("geom_quat", model.geom_quat)
    changed: list[dict[str, Any]] = []
    for part in parts(model):
        kind, _, number = part.name.partition("_")
        if kind != "geom":
            continue
        position, size, turn = positions[int(number)], sizes[int(number)], turns[int(number)]
        is_there = np.allclose(position, part.position) and np.allclose(size, part.size)
        is_turned = not np.allclose(turn, model.geom_quat[int(number)])
        if not is_there or is_turned:
            scale = part.scale(np.asarray(size, float))
            own = {"node": part.name, "translation": position.tolist(), "scale": scale.tolist()}
            # glTF has the real part last.
            changed.append(own | ({"rotation": np.roll(turn, -1).tolist()} if is_turned else {}))
    return changed
