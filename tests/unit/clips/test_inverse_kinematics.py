"""Key points of a known motion give the motion back."""

import mujoco
import numpy as np
import pytest

from core.clips.inverse_kinematics import BodyPoint, solve
from core.clips.kinematics import poses, qpos
from core.clips.quaternions import Array, conjugate, multiply, rotation_vector
from core.clips.skeleton import skeleton_of
from core.errors import BadClips
from tests.unit.clips.bodies import walker, walking

MAPPING = {
    "hip": BodyPoint("torso"),
    "chest": BodyPoint("torso", (0.1, 0.05, 0.2)),
    "back": BodyPoint("torso", (-0.1, 0.1, 0.1)),
    "nose": BodyPoint("head", (0.1, 0.0, 0.1)),
    "left_thigh": BodyPoint("left_thigh", (0.05, 0.0, -0.2)),
    "left_knee": BodyPoint("left_shin"),
    "left_toe": BodyPoint("left_shin", (0.1, 0.0, -0.4)),
    "right_thigh": BodyPoint("right_thigh", (0.05, 0.0, -0.2)),
    "right_knee": BodyPoint("right_shin"),
    "right_toe": BodyPoint("right_shin", (0.1, 0.0, -0.4)),
}
NAMES = [*MAPPING, "tail"]
MOTION = walking(num_frames=8, rate=15.0)


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return walker()


def seen(model: mujoco.MjModel) -> Array:
    """Where a camera would see the points, [T, K, 3] m; the tail is not seen."""
    found = poses(qpos(MOTION, skeleton_of(model)), model)
    points = np.full((MOTION.num_frames, len(NAMES), 3), np.nan)
    for place, point in enumerate(MAPPING.values()):
        body = model.body(point.body).id
        points[:, place] = found.body_positions[:, body] + found.body_turns[:, body] @ np.array(point.offset)
    return points


def test_the_motion_comes_back_from_its_points(model: mujoco.MjModel) -> None:
    found = solve(seen(model), NAMES, MAPPING, model, rate=15.0, name="walk")
    assert (found.clip.name, found.clip.rate, found.clip.joints) == ("walk", 15.0, MOTION.joints)
    assert np.nanmax(found.distances) < 1e-3
    assert np.isnan(found.distances[:, -1]).all()
    np.testing.assert_allclose(found.clip.root_position, MOTION.root_position, atol=1e-3)
    np.testing.assert_allclose(
        found.clip.joint_positions, MOTION.joint_positions, atol=0.02
    )  # see test_key_points.py
    turned = multiply(conjugate(MOTION.root_orientation), found.clip.root_orientation)
    assert np.linalg.norm(rotation_vector(turned), axis=1).max() < 5e-3


def test_a_point_that_is_lost_for_a_while_does_not_pull(model: mujoco.MjModel) -> None:
    points = seen(model)
    points[3:5, NAMES.index("left_toe")] = np.nan
    found = solve(points, NAMES, MAPPING, model, rate=15.0)
    assert np.nanmax(found.distances) < 5e-3
    # The knee that nothing shows stays where it was: it moves by less than 0.1 rad in this motion.
    np.testing.assert_allclose(found.clip.joint_positions, MOTION.joint_positions, atol=0.1)


def test_a_frame_with_a_point_far_off_does_not_move_the_fitted_offsets(model: mujoco.MjModel) -> None:
    points = seen(model)
    points[3, NAMES.index("nose")] += [3.0, 0.0, 0.0]
    found = solve(points, NAMES, MAPPING, model, rate=15.0, rounds=2)
    # A mean of the eight frames follows by 3 m / 8.
    moved = [np.linalg.norm(found.offsets[name] - point.offset) for name, point in MAPPING.items()]
    assert max(moved) < 0.01


def test_joints_stay_within_their_limits(model: mujoco.MjModel) -> None:
    points = seen(model)
    points[:, NAMES.index("left_toe"), 0] += 2.0  # where the shin would bend forwards
    found = solve(points, NAMES, MAPPING, model, rate=15.0)
    knee = found.clip.joint_positions[:, MOTION.joints.index("left_knee")]
    assert knee.min() > -1e-6


def test_what_does_not_fit_is_refused(model: mujoco.MjModel) -> None:
    points = seen(model)
    with pytest.raises(BadClips, match=r"the shape \[8, 11, 3\], not \[T, 10, 3\]"):
        solve(points, NAMES[:-1], MAPPING, model, rate=15.0)
    with pytest.raises(BadClips, match="The recording has no key points `wing`"):
        solve(points, NAMES, {"wing": BodyPoint("torso")}, model, rate=15.0)
    with pytest.raises(BadClips, match="The model has no body `wing`"):
        solve(points, NAMES, {**MAPPING, "tail": BodyPoint("wing")}, model, rate=15.0)
    points[5, :8] = np.nan
    with pytest.raises(BadClips, match="In frame 5, 2 of the mapped key points are seen; it takes 3"):
        solve(points, NAMES, MAPPING, model, rate=15.0)
