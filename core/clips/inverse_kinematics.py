"""Clips from the places of markers or key points: the poses in which a body's points are nearest to them.

Each frame is a least-squares problem within the joints' limits, which MuJoCo's own `mujoco.minimize` solves
from the pose of the frame before.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from mujoco import minimize
from numpy.typing import NDArray

from core.clips.clip import Clip
from core.clips.quaternions import Array
from core.clips.skeleton import Skeleton, listed, skeleton_of
from core.errors import BadClips

# A joint that turns by 1 rad from one frame to the next costs as much as a point that is this share of the
# body's size off its target. So joints that no point shows stay where they are, and noise shakes none.
_STIFFNESS = 0.02
# The solver stops at a step that changes the pose by less than this share: MuJoCo's own 1e-8 takes ten times
# as long.
_TOLERANCE = 1e-3
# The most iterations of the solver, where it begins far from the solution, and where it begins at the pose of
# the frame before.
_FIRST_ITERATIONS, _ITERATIONS = 300, 50
# The bound, in m or rad, of a step that has none.
_NO_BOUND = 1e3
# Key points that a frame shows; fewer do not say how the body is turned.
_FEWEST_POINTS = 3
# How many frames offsets are fitted to, as in stac-mjx.
FITTED_FRAMES = 100
# The weight of the given offset in the fitted one, beside a weight of 1 for all these frames together.
_GIVEN_WEIGHT = 0.1


@dataclass(frozen=True)
class BodyPoint:
    """A point of a body, at `offset` [m] in the body's frame."""

    body: str
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Solution:
    """distances: between each key point and the body's point, [T, K] m; NaN where the key point was not seen
    or is not used. offsets: of each key point that is used, as fitted, [3] m in the body's frame. spread: how
    far apart the body's points are, divided by how far apart the key points are.
    """

    clip: Clip
    distances: Array
    offsets: Mapping[str, Array]
    spread: float


def solve(  # noqa: PLR0913 # All but the recording and the body are named.
    key_points: Array,
    names: Sequence[str],
    mapping: Mapping[str, BodyPoint],
    model: mujoco.MjModel,
    *,
    rate: float,
    name: str = "clip",
    rounds: int = 0,
    begin: Callable[[int, int], object] = lambda frame, num_frames: None,
) -> Solution:
    """The clip whose poses follow the key points, without velocities.

    key_points: [T, K, 3] m in the world; NaN where one was not seen. names: of the K. mapping: which point of
    which body each key point is; a key point that it does not name is not used. rate: frames per second.
    rounds: how often poses are solved and the points' offsets fitted to them, before the clip itself is
    solved (STAC: Wu et al., 2013). begin: is told each frame that comes next, and how many there are.
    Raises BadClips.
    """
    skeleton = skeleton_of(model)
    used = _used(key_points, names, mapping)
    fit = _Fit(skeleton, [mapping[names[place]] for place in used])
    seen = key_points[:, used]
    distances = np.full(key_points.shape[:2], np.nan)
    ours, rows = np.empty_like(seen), np.empty((len(seen), model.nq))
    row = np.asarray(model.qpos0).copy()
    if skeleton.root_joint is not None:
        row = fit.with_root(row, seen[0])
    for _ in range(rounds):
        fit.fit_offsets(row, seen)
    for frame, targets in enumerate(seen):
        begin(frame, len(seen))
        row = fit.nearest(row, targets, _ITERATIONS if frame else _FIRST_ITERATIONS)
        rows[frame], ours[frame] = row, fit.points(row)
    distances[:, used] = np.linalg.norm(ours - seen, axis=-1)
    ours[np.isnan(distances[:, used])] = np.nan
    offsets = {names[place]: offset for place, offset in zip(used, fit.offsets, strict=True)}
    return Solution(_clip(rows, skeleton, rate, name), distances, offsets, _spread(ours) / _spread(seen))


def spreads(
    key_points: Array, names: Sequence[str], mapping: Mapping[str, BodyPoint], model: mujoco.MjModel
) -> tuple[float, float]:
    """How far apart the key points are, and how far apart the body's points are in its initial pose, as
    `_spread` has it. Arguments as for `solve`. Raises BadClips."""
    used = _used(key_points, names, mapping)
    fit = _Fit(skeleton_of(model), [mapping[names[place]] for place in used])
    return _spread(key_points[:, used]), _spread(fit.points(np.asarray(model.qpos0))[None])


def _spread(points: Array) -> float:
    """The median over the frames of the points' root mean square distance from their centre, in m.

    points: [T, K, 3] m; NaN where one was not seen.
    """
    with np.errstate(over="ignore"):  # A point may be anywhere.
        apart = points - np.nanmean(points, axis=1, keepdims=True)
        return float(np.median(np.sqrt(np.nanmean((apart**2).sum(axis=-1), axis=1))))


def _used(key_points: Array, names: Sequence[str], mapping: Mapping[str, BodyPoint]) -> list[int]:
    """The numbers of the key points that the mapping names. Raises BadClips."""
    if key_points.ndim != 3 or key_points.shape[1:] != (len(names), 3):
        shape = list(key_points.shape)
        raise BadClips(f"The key points have the shape {shape}, not [T, {len(names)}, 3] as their names ask.")
    if unknown := [name for name in mapping if name not in names]:
        raise BadClips(f"The recording has no key points {listed(unknown)}.")
    used = [place for place, name in enumerate(names) if name in mapping]
    if len(key_points) < 2:
        raise BadClips(f"The recording has {len(key_points)} frames; motion needs at least two.")
    number = np.isfinite(key_points[:, used]).all(axis=-1).sum(axis=1)
    if (number < _FEWEST_POINTS).any():
        frame = int((number < _FEWEST_POINTS).argmax())
        raise BadClips(
            f"In frame {frame}, {number[frame]} of the mapped key points are seen; it takes {_FEWEST_POINTS}."
        )
    return used


def _clip(rows: Array, skeleton: Skeleton, rate: float, name: str) -> Clip:
    position, orientation = np.zeros((len(rows), 3)), np.tile([1.0, 0.0, 0.0, 0.0], (len(rows), 1))
    if skeleton.root_joint is not None:
        start = skeleton.root_address
        position, orientation = rows[:, start : start + 3], rows[:, start + 3 : start + 7]
    joints = rows[:, skeleton.joint_addresses]
    return Clip(name, rate, position, orientation, skeleton.joints, joints)


class _Fit:
    """Fits the poses of one body to key points. Each call overwrites its MuJoCo data."""

    def __init__(self, skeleton: Skeleton, points: Sequence[BodyPoint]) -> None:
        """Raises BadClips for a body that the model lacks."""
        model = skeleton.model
        bodies = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, point.body) for point in points]
        if -1 in bodies:
            raise BadClips(f"The model has no body `{points[bodies.index(-1)].body}`.")
        self._skeleton, self._model, self._data = skeleton, model, mujoco.MjData(model)
        self._bodies = np.array(bodies, int)
        self._given = np.array([point.offset for point in points], float)
        self.offsets = self._given.copy()
        self._stiffness = _STIFFNESS * skeleton.size
        dofs = list(np.asarray(model.jnt_dofadr)[skeleton.joint_ids])
        if skeleton.root_joint is not None:
            start = int(model.jnt_dofadr[skeleton.root_joint])
            dofs = [*range(start, start + 6), *dofs]
        self._dofs = np.array(dofs, int)
        self._num_joints = len(skeleton.joint_ids)

    def points(self, row: Array) -> Array:
        """Where the body's points are, [K, 3] m. row: [nq]."""
        self._data.qpos[:] = row
        mujoco.mj_kinematics(self._model, self._data)
        turns = self._data.xmat[self._bodies].reshape(-1, 3, 3)
        return self._data.xpos[self._bodies] + np.einsum("kij,kj->ki", turns, self.offsets)

    def with_root(self, row: Array, targets: Array) -> Array:
        """The pose with its root moved and turned so that the body's points, with the joints as they are, are
        nearest to the targets (Kabsch, 1976). row: [nq]. targets: [K, 3] m."""
        seen = np.isfinite(targets).all(axis=-1)
        ours, theirs = self.points(row)[seen], targets[seen]
        centre, aim = ours.mean(axis=0), theirs.mean(axis=0)
        left, _, right = np.linalg.svd((ours - centre).T @ (theirs - aim))
        handed = np.diag([1.0, 1.0, np.sign(np.linalg.det(right.T @ left.T))])
        turn = right.T @ handed @ left.T
        quaternion, moved, start = np.empty(4), row.copy(), self._skeleton.root_address
        mujoco.mju_mat2Quat(quaternion, turn.ravel())
        mujoco.mju_mulQuat(moved[start + 3 : start + 7], quaternion, row[start + 3 : start + 7])
        moved[start : start + 3] = turn @ (row[start : start + 3] - centre) + aim
        return moved

    def fit_offsets(self, row: Array, seen: Array) -> None:
        """Move each point to the median, over some frames, of its key point's place in the body's frame.

        row: [nq], where the search for the first pose begins. seen: [T, K, 3] m. The given offset has a
        weight beside it: without it the body could lie anywhere under its points. A mean would follow the few
        frames in which a key point is far off.
        """
        places: list[Array] = []
        for frame in np.unique(np.linspace(0, len(seen) - 1, FITTED_FRAMES).astype(int)):
            row = self.nearest(row, seen[frame], _FIRST_ITERATIONS)
            self.points(row)
            turns = self._data.xmat[self._bodies].reshape(-1, 3, 3)
            places.append(np.einsum("kji,kj->ki", turns, seen[frame] - self._data.xpos[self._bodies]))
        found = np.stack(places)
        number = np.isfinite(found).all(axis=-1).sum(axis=0)[:, None]
        weight = _GIVEN_WEIGHT * len(found)
        middle = np.nanmedian(np.where(number, found, self._given), axis=0)
        self.offsets = (number * middle + weight * self._given) / (number + weight)

    def nearest(self, row: Array, targets: Array, iterations: int) -> Array:
        """The pose [nq] whose points are nearest to the targets.

        row: [nq], where the search begins. targets: [K, 3] m; NaN where one was not seen.
        """
        seen = np.flatnonzero(np.isfinite(targets).all(axis=-1))

        def residual(steps: Array) -> Array:
            columns = [
                np.concatenate(
                    [
                        (self.points(self._stepped(row, step))[seen] - targets[seen]).ravel(),
                        self._stiffness * step[len(step) - self._num_joints :],
                    ]
                )
                for step in steps.T
            ]
            return np.stack(columns, axis=1)

        def jacobian(step: Array, _: Array) -> Array:
            return self._jacobian(row, step.ravel(), seen)

        bounds = self._bounds(row)
        start = np.clip(np.zeros(len(self._dofs)), *bounds)
        step, _ = minimize.least_squares(
            start, residual, bounds, jacobian, xtol=_TOLERANCE, max_iter=iterations, verbose=0
        )
        return self._stepped(row, np.asarray(step).ravel())

    def _jacobian(self, row: Array, step: Array, seen: NDArray[np.int_]) -> Array:
        """The derivative of the residual by the step, [3 * seen + joints, dofs]."""
        places = self.points(self._stepped(row, step))
        mujoco.mj_comPos(self._model, self._data)
        found = np.zeros((len(seen), 3, self._model.nv))
        for rows, place in zip(found, seen, strict=True):
            mujoco.mj_jac(self._model, self._data, rows, None, places[place], self._bodies[place])
        moved = found.reshape(-1, self._model.nv)[:, self._dofs]
        if self._skeleton.root_joint is not None:
            moved[:, 3:6] = moved[:, 3:6] @ _turned_by(step[3:6])
        stiff = np.zeros((self._num_joints, len(step)))
        stiff[:, len(step) - self._num_joints :] = self._stiffness * np.eye(self._num_joints)
        return np.concatenate([moved, stiff])

    def _stepped(self, row: Array, step: Array) -> Array:
        moved, speeds = row.copy(), np.zeros(self._model.nv)
        speeds[self._dofs] = step
        mujoco.mj_integratePos(self._model, moved, speeds, 1.0)
        return moved

    def _bounds(self, row: Array) -> list[Any]:
        """The lowest and the highest step: those to the joints' limits; the root has no limits."""
        model, ids = self._model, self._skeleton.joint_ids
        limited: NDArray[np.bool_] = np.asarray(model.jnt_limited, bool)[ids]
        low, high = np.asarray(model.jnt_range)[ids].T
        here = row[self._skeleton.joint_addresses]
        free = np.full(len(self._dofs) - self._num_joints, _NO_BOUND)
        return [
            np.concatenate([-free, np.where(limited, low - here, -_NO_BOUND)]),
            np.concatenate([free, np.where(limited, high - here, _NO_BOUND)]),
        ]


def _turned_by(turn: Array) -> Array:
    """How a change of a rotation vector [3] rad turns the body in its own frame, [3, 3].

    It is the right Jacobian of rotations (Sola et al., 2018, A micro Lie theory, eq. 143).
    """
    angle = float(np.linalg.norm(turn))
    x, y, z = turn
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if angle < 1e-4:
        return np.eye(3) - cross / 2
    first, second = (1 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3
    return np.eye(3) - first * cross + second * cross @ cross
