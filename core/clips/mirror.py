"""Left and right of a body exchanged: by the names of its joints, where they are and how they turn."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from core.clips.clip import Clip
from core.clips.quaternions import Array, multiply
from core.clips.skeleton import Skeleton, listed
from core.errors import BadClips

# What a real body's sides may differ by: of its size, and 1 - cos of an angle (3.6°).
_APART, _TURNED = 0.01, 0.002
_SIDES = (("left", "right"), ("Left", "Right"), ("LEFT", "RIGHT"), ("l", "r"), ("L", "R"))
_OTHER = {one: other for left, right in _SIDES for one, other in ((left, right), (right, left))}
# A letter alone is a side only as a word of its own.
_SIDE = re.compile(r"left|Left|LEFT|right|Right|RIGHT|(?<![A-Za-z0-9])[lLrR](?![A-Za-z0-9])")
_ACROSS = np.array([1.0, -1.0, 1.0])  # a reflection in the world's plane y = 0


@dataclass(frozen=True, eq=False)
class Mirror:
    """How a body's pose is reflected.

    joints: the body's. partners: [J], the joint whose position each joint takes; a joint in the middle takes
    its own. signs, offsets: [J], what that is multiplied by, and what is added. turn: [4], the quaternion
    that comes behind the root's reflected one; not the identity for a root whose y axis is not its side.
    """

    joints: tuple[str, ...]
    partners: NDArray[np.int_]
    signs: Array
    offsets: Array
    turn: Array


def mirror_of(skeleton: Skeleton) -> Mirror:
    """The reflection of the body in its sagittal plane. Raises BadClips if it is not symmetric, with a joint.

    Of the three planes through the root's origin it is the one in which most joints have partners. Where
    names say left and right (`left_knee`, `knee_L`), these are partners or none.
    """
    joints = _Joints.of(skeleton)
    sides = [_ACROSS] if skeleton.root_joint is None else list(1 - 2 * np.eye(3)[[1, 0, 2]])
    matches = [joints.partners(side, _APART * skeleton.size) for side in sides]
    best = max(range(len(sides)), key=lambda place: int((matches[place][0] >= 0).sum()))
    side, (partners, signs) = sides[best], matches[best]
    alone = np.flatnonzero(partners < 0)
    if len(alone):
        raise BadClips(
            "The body is not symmetric, so clips of it cannot be mirrored: no joint is the mirror image of "
            f"`{skeleton.joints[alone[0]]}`."
        )
    if not np.array_equal(partners[partners], np.arange(len(partners))):
        odd = int(np.flatnonzero(partners[partners] != np.arange(len(partners)))[0])
        raise BadClips(
            f"The body is not symmetric, so clips of it cannot be mirrored: `{skeleton.joints[odd]}` and "
            f"`{skeleton.joints[partners[odd]]}` are not each other's mirror image."
        )
    # A pose is the angle beyond that of the model as it is written.
    reference = np.asarray(skeleton.model.qpos0)[skeleton.joint_addresses]
    turn = np.empty(4)
    mujoco.mju_mat2Quat(turn, (np.diag(_ACROSS) @ np.diag(side)).ravel())
    return Mirror(skeleton.joints, partners, signs, reference - signs * reference[partners], turn)


def mirrored(clip: Clip, mirror: Mirror) -> Clip:
    """The clip as a mirror in the world's plane y = 0 shows it. Mirrored twice it is itself.

    Raises BadClips if it has a joint that the body lacks, or one without its partner.
    """
    across, spin = _ACROSS, -_ACROSS  # of places, and of angular velocities
    of_clip, partners = _of_clip(clip, mirror)
    behind = mirror.turn
    # R' = S R side = (S R S) (S side): the reflected turn, and then the root's own axes.
    orientation = multiply(clip.root_orientation * np.array([1.0, -1.0, 1.0, -1.0]), behind)
    changes: dict[str, Array] = {
        "root_position": clip.root_position * across,
        "root_orientation": orientation,
        "joint_positions": clip.joint_positions[:, partners] * mirror.signs[of_clip]
        + mirror.offsets[of_clip],
    }
    if clip.root_linear_velocity is not None:
        changes["root_linear_velocity"] = clip.root_linear_velocity * across
    if clip.root_angular_velocity is not None:
        # `turn` has exchanged the axes of the root's frame.
        turned = np.empty(9)
        mujoco.mju_quat2Mat(turned, behind)
        changes["root_angular_velocity"] = (clip.root_angular_velocity * spin) @ turned.reshape(3, 3)
    if clip.joint_velocities is not None:
        changes["joint_velocities"] = clip.joint_velocities[:, partners] * mirror.signs[of_clip]
    return replace(clip, **changes)


def _of_clip(clip: Clip, mirror: Mirror) -> tuple[list[int], list[int]]:
    """The mirror's number of each of the clip's joints, and the clip's column of its partner."""
    of_clip = [mirror.joints.index(name) if name in mirror.joints else -1 for name in clip.joints]
    if -1 in of_clip:
        unknown = clip.joints[of_clip.index(-1)]
        raise BadClips(f"The clip {clip.name!r} is of another body: the body has no `{unknown}`.")
    partners = [mirror.joints[mirror.partners[number]] for number in of_clip]
    if lacks := [name for name in partners if name not in clip.joints]:
        raise BadClips(f"The clip {clip.name!r} cannot be mirrored: it lacks {listed(lacks)}.")
    return of_clip, [clip.joints.index(name) for name in partners]


@dataclass(frozen=True, eq=False)
class _Joints:
    """Anchors [J, 3] and axes [J, 3] in the root's frame, with the model as it is written, and the kinds [J].

    parents: [J], the joint next above each, or -1. named: [J], the one of the other side by its name, or -1.
    """

    anchors: Array
    axes: Array
    kinds: NDArray[np.int_]
    parents: NDArray[np.int_]
    named: NDArray[np.int_]

    @classmethod
    def of(cls, skeleton: Skeleton) -> "_Joints":
        model = skeleton.model
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        place, turn = data.xpos[skeleton.root_body], data.xmat[skeleton.root_body].reshape(3, 3)
        ids = skeleton.joint_ids
        return cls(
            (data.xanchor[ids] - place) @ turn,
            data.xaxis[ids] @ turn,
            np.asarray(model.jnt_type)[ids],
            _parents(skeleton),
            _named_partners(skeleton.joints),
        )

    def partners(self, side: Array, apart: float) -> tuple[NDArray[np.int_], Array]:
        """The mirror image of each joint, -1 if there is none, and the sign of its angle.

        A slide's axis is reflected like a place. A hinge turns the other way round its reflected axis.
        """
        found = np.full(len(self.anchors), -1)
        signs = np.ones(len(self.anchors))
        for joint, (anchor, axis, kind) in enumerate(zip(self.anchors, self.axes, self.kinds, strict=True)):
            reflected = axis * side if kind == int(mujoco.mjtJoint.mjJNT_SLIDE) else -axis * side
            # Joints come after their parents, whose partners are known.
            above = -1 if self.parents[joint] < 0 else found[self.parents[joint]]
            distance = np.linalg.norm(self.anchors - anchor * side, axis=1)
            turned = 1 - np.abs(self.axes @ reflected)
            fits = (self.kinds == kind) & (distance < apart) & (turned < _TURNED) & (self.parents == above)
            if self.named[joint] >= 0:
                fits &= np.arange(len(fits)) == self.named[joint]
            if fits.any():
                found[joint] = int(np.where(fits, distance + turned, np.inf).argmin())
                signs[joint] = np.sign(self.axes[found[joint]] @ reflected)
        return found, signs


def _named_partners(names: Sequence[str]) -> NDArray[np.int_]:
    others = [re.sub(_SIDE, lambda found: _OTHER[found[0]], name) for name in names]
    return np.array(
        [
            names.index(other) if other != name and other in names else -1
            for name, other in zip(names, others, strict=True)
        ],
        int,
    )


def _parents(skeleton: Skeleton) -> NDArray[np.int_]:
    model = skeleton.model
    place_of = {int(joint): place for place, joint in enumerate(skeleton.joint_ids)}
    last_of_body: dict[int, int] = {}
    parents: list[int] = []
    for joint in skeleton.joint_ids:
        body = int(model.jnt_bodyid[joint])
        above = body
        while above > 0 and above not in last_of_body:
            above = int(model.body_parentid[above])
        parents.append(last_of_body.get(above, -1))
        last_of_body[body] = place_of[int(joint)]
    return np.array(parents, int)
