"""The part of a MuJoCo model that clips move: its root, its hinges and slides, and where a pose puts them."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from core.clips.clip import Clip, arrays
from core.errors import BadClips

_FREE, _BALL = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_BALL)
_MOST_NAMED = 8


@dataclass(frozen=True, eq=False)
class Skeleton:
    """A body of the model with all that hangs on it.

    root_joint: the number of its free joint; None where it is fixed to the world. root_body: that joint's
    body; 0, the world, without one. joints: the names of its hinges and slides in MuJoCo's order, joint_ids
    their numbers. bodies: the numbers of its bodies. size: m, the greatest distance of two of its bodies.
    """

    model: mujoco.MjModel
    root_joint: int | None
    root_body: int
    joints: tuple[str, ...]
    joint_ids: NDArray[np.int_]
    bodies: NDArray[np.int_]
    size: float

    @property
    def joint_addresses(self) -> NDArray[np.int_]:
        """Where its hinges and slides are in `qpos`."""
        return np.asarray(self.model.jnt_qposadr)[self.joint_ids]

    @property
    def joints_by_depth(self) -> tuple[str, ...]:
        """Its joints level by level, as simulators that walk a body breadth first have them."""
        model = self.model
        depths = np.zeros(model.nbody, int)
        for body in range(1, model.nbody):
            depths[body] = depths[model.body_parentid[body]] + 1
        order = np.argsort(depths[np.asarray(model.jnt_bodyid)[self.joint_ids]], kind="stable")
        return tuple(self.joints[place] for place in order)

    @property
    def root_address(self) -> int:
        """Where the root's position begins in `qpos`. Only of a body with a free joint."""
        return int(self.model.jnt_qposadr[self.root_joint])


def skeleton_of(model: mujoco.MjModel) -> Skeleton:
    """The body with the free joint; of several such bodies, the one with the most joints.

    Without a free joint it is all that moves in the model. Raises BadClips for a body with a ball joint, and
    for one whose joints have no names of their own.
    """
    kinds = np.asarray(model.jnt_type)
    free = [int(joint) for joint in np.flatnonzero(kinds == _FREE)]
    joint_bodies = np.asarray(model.jnt_bodyid)
    trees = {joint: _subtree(model, int(joint_bodies[joint])) for joint in free}
    root = max(free, key=lambda joint: int(np.isin(joint_bodies, trees[joint]).sum()), default=None)
    root_body = 0 if root is None else int(joint_bodies[root])
    bodies = _subtree(model, root_body)
    inside = np.isin(joint_bodies, bodies)
    if balls := _names(model, np.flatnonzero(inside & (kinds == _BALL))):
        raise BadClips(f"Clips move hinges and slides, but {listed(balls)} of this body is a ball joint.")
    joint_ids = np.flatnonzero(inside & (kinds != _FREE))
    joints = _names(model, joint_ids)
    if "" in joints:
        raise BadClips(f"Joint {joint_ids[joints.index('')]} of this body has no name: clips go by names.")
    return Skeleton(model, root, root_body, tuple(joints), joint_ids, bodies, _size(model, bodies))


def aligned(clip: Clip, skeleton: Skeleton) -> Clip:
    """The clip with its joints in the order of the model's. Raises BadClips if they are not the same joints.

    What all its names have in front up to a `/`, and behind from a `-` on, may differ: dm_control and
    stac-mjx put the name of the body there.
    """
    found = list(clip.joints)
    if set(found) != set(skeleton.joints):
        plain = [_plain(name) for name in found]
        ours = {_plain(name): name for name in skeleton.joints}
        if set(plain) == set(ours):
            found = [ours[name] for name in plain]
    if len(set(found)) < len(found):
        twice = next(name for name in found if found.count(name) > 1)
        raise BadClips(f"The clip {clip.name!r} has the joint {twice!r} twice.")
    lacks = [name for name in skeleton.joints if name not in found]
    unknown = [name for name in found if name not in skeleton.joints]
    if lacks or unknown:
        parts = [f"it lacks {listed(lacks)}"] if lacks else []
        parts += [f"the body has no {listed(unknown, 'or')}"] if unknown else []
        raise BadClips(f"The clip {clip.name!r} is of another body: {', and '.join(parts)}.")
    order = [found.index(name) for name in skeleton.joints]
    moved = {name: values[:, order] for name, values in arrays(clip).items() if name.startswith("joint_")}
    return replace(
        clip,
        joints=skeleton.joints,
        joint_positions=moved["joint_positions"],
        joint_velocities=moved.get("joint_velocities"),
    )


def listed(names: Sequence[str], last: str = "and") -> str:
    """At most eight names, and how many more there are."""
    quoted = [f"`{name}`" for name in names[:_MOST_NAMED]]
    if len(names) > _MOST_NAMED:
        quoted.append(f"{len(names) - _MOST_NAMED} more")
    return quoted[0] if len(quoted) == 1 else f"{', '.join(quoted[:-1])} {last} {quoted[-1]}"


def _plain(name: str) -> str:
    return name.rpartition("/")[2].partition("-")[0]


def _names(model: mujoco.MjModel, joints: Iterable[int]) -> list[str]:
    return [str(model.joint(int(joint)).name) for joint in joints]


def _subtree(model: mujoco.MjModel, root: int) -> NDArray[np.int_]:
    """The body and all that hang on it. Parents come before their children in MuJoCo."""
    inside = np.zeros(model.nbody, bool)
    inside[root] = True
    for body in range(root + 1, model.nbody):
        inside[body] = inside[model.body_parentid[body]]
    return np.flatnonzero(inside)


def _size(model: mujoco.MjModel, bodies: NDArray[np.int_]) -> float:
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    places = data.xpos[bodies[bodies > 0]]
    apart = np.linalg.norm(places[:, None] - places[None], axis=-1).max(initial=0.0)
    return float(apart) or float(model.stat.extent)
