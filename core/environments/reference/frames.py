"""From clips to frames: every quantity that a step compares, computed once, on the host, by C MuJoCo."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np

from core.clips import clip as clips
from core.clips.archive import from_file
from core.clips.clip import Clip
from core.clips.mirror import mirror_of, mirrored
from core.clips.options import ClipChoice, called, distinct
from core.clips.skeleton import skeleton_of
from core.environments.terms.followed import Followed
from core.environments.terms.reference import Frame, too_many_frames
from core.errors import BadClips, JobFailed
from core.patterns import matching
from core.reasons import Reason


@dataclass(frozen=True)
class Frames:
    """The frames of all clips, one clip after the other.

    frames: rows [N, …]. activations: [N, na], the states of actuators with which an episode begins there.
    names, weights, starts, lengths: of the clips; no two names are the same, starts are rows, lengths counted
    in frames, at least two each.
    """

    frames: Frame
    activations: np.ndarray
    names: Sequence[str]
    weights: np.ndarray
    starts: np.ndarray
    lengths: np.ndarray


def frames_of(
    chosen: Sequence[tuple[Clip, float]], model: mujoco.MjModel, followed: Followed, pose: np.ndarray
) -> Frames:
    """The frames of clips, each with its weight, at the rate that they have. pose: positions [nq] of joints
    that a clip lacks.

    Raises JobFailed("bad_clips") where a clip has joints that the model lacks, or no joint, and where the
    frames are more than a program can hold.
    """
    num_frames = sum(one.num_frames for one, _ in chosen)
    if (why := too_many_frames(num_frames, model.nq, model.nv, len(followed.bodies))) is not None:
        raise _bad(why)
    parts, activations = zip(*(_frames(one, model, followed, pose) for one, _ in chosen), strict=True)
    lengths = np.array([len(part.qpos) for part in parts])
    return Frames(
        frames=Frame(*(np.concatenate(rows).astype(np.float32) for rows in zip(*parts, strict=True))),
        activations=np.concatenate(activations).astype(np.float32),
        names=distinct([one.name for one, _ in chosen]),
        weights=np.array([weight for _, weight in chosen]),
        starts=np.concatenate([[0], np.cumsum(lengths)[:-1]]),
        lengths=lengths,
    )


def chosen_clips(
    choices: Sequence[ClipChoice], files: Mapping[str, Path], rate: float, model: mujoco.MjModel
) -> Iterator[tuple[Clip, float]]:
    """The clips of a job as it asks for them, with their weights. files: by the ids of the choices. rate: in
    frames per second.

    A clip that is mirrored or played at another speed is called so.

    Raises JobFailed("bad_clips") where a file is missing or cannot be read, has no such clip, a clip is over
    before it begins, or it is to be mirrored and the body is not symmetric.
    """
    for choice in choices:
        if (file := files.get(choice.file)) is None:
            raise _bad(f"The file of the clips {choice.file} is missing.")
        try:
            found = from_file(file)
            for name in _named(choice, [one.name for one in found]):
                one = next(one for one in found if one.name == name)
                yield _changed(one, choice, rate, model), choice.weight
        except (ValueError, BadClips) as error:
            raise _bad(str(error)) from None


def _named(choice: ClipChoice, names: Sequence[str]) -> Sequence[str]:
    if choice.names is None:
        return names
    for pattern in choice.names:
        if not matching([pattern], names):
            raise _bad(f"No clip of {choice.file} is called {pattern!r}; there are {', '.join(names[:20])}.")
    return matching(choice.names, names)


def _changed(clip: Clip, choice: ClipChoice, rate: float, model: mujoco.MjModel) -> Clip:
    clip = clips.cut(clip, choice.from_s, choice.to_s)
    if choice.mirror:
        clip = mirrored(clip, mirror_of(skeleton_of(model)))
    clip = clips.with_velocities(clip if choice.speed == 1.0 else clips.sped_up(clip, choice.speed))
    clip = clips.resampled(clip, rate)
    if clip.num_frames < 2:
        raise _bad(f"The clip {clip.name!r} lasts less than a control step of {1 / rate:g} s.")
    return replace(clip, name=called(clip.name, choice))


def _frames(
    clip: Clip, model: mujoco.MjModel, followed: Followed, pose: np.ndarray
) -> tuple[Frame, np.ndarray]:
    """The rows of one clip, [T, …], which has velocities, and the states of actuators there, [T, na]."""
    qpos, qvel = _states(clip, model, followed, pose)
    data, rows = mujoco.MjData(model), list[tuple[np.ndarray, ...]]()
    actuator_lengths = np.empty((len(qpos), model.nu))
    bodies = followed.bodies
    for positions, velocities, actuator_length in zip(qpos, qvel, actuator_lengths, strict=True):
        data.qpos[:], data.qvel[:] = positions, velocities
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_tendon(model, data)
        mujoco.mj_transmission(model, data)
        mujoco.mj_comVel(model, data)
        actuator_length[:] = data.actuator_length
        derived = {"cvel": data.cvel, "xpos": data.xpos, "subtree_com": data.subtree_com}
        rows.append((data.xpos[bodies], data.xquat[bodies], *followed.velocities(derived, np)))
    frame = Frame(qpos, qvel, *(np.stack(parts) for parts in zip(*rows, strict=True)))
    return frame, _at_rest(actuator_lengths, model)


def _at_rest(lengths: np.ndarray, model: mujoco.MjModel) -> np.ndarray:
    """States of actuators [T, na] in which position servos that follow their control slowly exert no force at
    these actuator lengths [T, nu]; 0 of all others. Recordings lack them, and from 0 such servos pull towards
    their own zeros.
    """
    first, gain, bias = model.actuator_actadr, model.actuator_gainprm[:, 0], model.actuator_biasprm
    is_servo = (first >= 0) & (model.actuator_actnum == 1) & (gain != 0)
    is_servo &= np.isin(model.actuator_dyntype, [mujoco.mjtDyn.mjDYN_FILTER, mujoco.mjtDyn.mjDYN_FILTEREXACT])
    is_servo &= model.actuator_gaintype == mujoco.mjtGain.mjGAIN_FIXED
    is_servo &= model.actuator_biastype == mujoco.mjtBias.mjBIAS_AFFINE
    [servos] = np.nonzero(is_servo)
    low, high = model.actuator_ctrlrange[servos].T
    limited = model.actuator_ctrllimited[servos] == 1
    low, high = np.where(limited, low, -np.inf), np.where(limited, high, np.inf)
    force = bias[servos, 0] + bias[servos, 1] * lengths[:, servos]
    activations = np.zeros((len(lengths), model.na))
    activations[:, first[servos]] = np.clip(-force / gain[servos], low, high)
    return activations


def _states(
    clip: Clip, model: mujoco.MjModel, followed: Followed, pose: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Positions [T, nq] and velocities [T, nv]."""
    known = {model.joint(number).name: number for number in range(model.njnt)}
    if lacking := [name for name in clip.joints if name not in known]:
        names = ", ".join(lacking[:10])
        raise _bad(f"The clip {clip.name!r} is of another body: the model has no joint {names}.")
    joints = [known[name] for name in clip.joints]
    if not joints and followed.joints.size:
        raise _bad(f"The clip {clip.name!r} moves none of the body's joints.")
    qpos = np.tile(pose, (clip.num_frames, 1))
    qvel = np.zeros((clip.num_frames, model.nv))
    start = followed.root
    [root] = np.flatnonzero(model.jnt_qposadr == start)
    speeds = model.jnt_dofadr[root]
    qpos[:, start : start + 3], qpos[:, start + 3 : start + 7] = clip.root_position, clip.root_orientation
    qvel[:, speeds : speeds + 3] = clip.root_linear_velocity
    qvel[:, speeds + 3 : speeds + 6] = clip.root_angular_velocity
    qpos[:, model.jnt_qposadr[joints]] = clip.joint_positions
    qvel[:, model.jnt_dofadr[joints]] = clip.joint_velocities
    return qpos, qvel


def _bad(detail: str) -> JobFailed:
    return JobFailed(Reason.BAD_CLIPS, detail)
