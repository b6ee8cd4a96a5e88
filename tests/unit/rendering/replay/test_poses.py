"""The poses of a replay are those of MuJoCo's kinematics."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from core.rendering.replay.poses import followed_bodies, frame_rows, moving_bodies, poses
from tests.unit.rendering.replay.models import ARM, model_of, rolling

_UNITS = 32767


def test_poses_equal_mujocos_for_each_frame() -> None:
    model, motion = model_of(ARM), rolling()
    found = poses(model, motion)
    arrays, data = found.arrays, mujoco.MjData(model)
    bodies = moving_bodies(model)
    assert [model.body(body).name for body in bodies] == ["ball", "arm"]
    position = arrays["origin"][:, None] + found.scale_m / _UNITS * arrays["position"]
    rotation = arrays["rotation"] / _UNITS
    for frame, qpos in enumerate(motion.qpos):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        # Half a unit: the arm is 0.3 m from the ball, so the scale is about 0.3 m / 32767 = 9 micrometres.
        np.testing.assert_allclose(position[frame], data.xpos[bodies], atol=found.scale_m / _UNITS + 1e-6)
        np.testing.assert_allclose(rotation[frame], data.xquat[bodies], atol=1 / _UNITS)
    np.testing.assert_allclose(arrays["time"], motion.time, atol=1e-6)


def test_the_ball_touches_the_floor_below_it_and_is_pushed_up() -> None:
    found = poses(model_of(ARM), rolling())
    arrays = found.arrays
    assert arrays["contact_count"].sum() == len(arrays["contact_position"]) == len(arrays["contact_normal"])
    assert arrays["contact_count"][0] == 1
    # The centre is 0.299 m above the floor, the radius 0.3 m: they meet half way, 0.0005 m below the floor.
    place = arrays["origin"][0] + found.scale_m / _UNITS * arrays["contact_position"][0]
    np.testing.assert_allclose(place, [0.0, 0.0, -0.0005], atol=1e-4)
    np.testing.assert_allclose(np.abs(arrays["contact_normal"][0]), [0, 0, _UNITS], atol=2)


def test_a_tendon_runs_from_site_to_site() -> None:
    arrays = poses(model_of(ARM), rolling()).arrays
    assert (arrays["tendon_count"] == 1).all()
    # At rest the ball's site is 0.3 m above its centre.
    np.testing.assert_allclose(arrays["tendon_segment"][0], [[0, 1, 0], [0, 0, 0.599]], atol=1e-5)


def test_the_target_is_where_the_episode_has_it_at_the_height_of_the_model() -> None:
    target = np.stack([np.linspace(0, 5, 41), np.full(41, -2.0)], axis=1)
    model = model_of(ARM)
    arrays = poses(model, rolling(target=target)).arrays
    np.testing.assert_allclose(arrays["target"][-1], [5.0, -2.0, 0.25])
    assert "target" not in poses(model, rolling()).arrays
    assert model.body("target").pos[0] == 0.0  # The caller's model is as it was.


def test_what_the_body_is_told_and_does_is_kept_for_each_frame() -> None:
    velocities = np.arange(41 * 6.0).reshape(41, 2, 3)
    motion = rolling(velocities=velocities)
    arrays, rows = poses(model_of(ARM), motion).arrays, frame_rows(motion.time)
    np.testing.assert_array_equal(arrays["command"], velocities[rows, 0])
    np.testing.assert_array_equal(arrays["velocity"], velocities[rows, 1])
    assert arrays["command"].dtype == np.float32
    assert not {"command", "velocity"} & poses(model_of(ARM), rolling()).arrays.keys()


def test_the_tree_of_a_body_that_follows_a_clip_stands_where_the_clip_has_it_too() -> None:
    model, motion = model_of(ARM), rolling()
    reference = motion.qpos + np.array([3.0, *[0.0] * 7])
    followed = followed_bodies(model, model.body("arm").id)
    assert [model.body(body).name for body in followed] == ["ball", "arm"]
    arrays = poses(model, replace(motion, reference=reference), followed).arrays
    np.testing.assert_allclose(arrays["reference_origin"], arrays["origin"] + [3, 0, 0], atol=1e-6)
    np.testing.assert_array_equal(arrays["reference_position"], arrays["position"])
    np.testing.assert_array_equal(arrays["reference_rotation"], arrays["rotation"])
    assert "reference_position" not in poses(model, motion, followed).arrays


def test_a_target_that_joints_move_is_a_body_like_others() -> None:
    slide = '<body name="target" pos="0 0 0.25"><joint type="slide" axis="1 0 0"/>'
    model = model_of(ARM.replace('<body name="target" pos="0 0 0.25">', slide))
    assert [model.body(body).name for body in moving_bodies(model)] == ["target", "ball", "arm"]


def test_geoms_that_an_episode_has_elsewhere_are_named_with_their_stretch() -> None:
    model = model_of(ARM)
    position, size = model.geom_pos.copy(), model.geom_size.copy()
    ball = 2
    position[ball], size[ball, 0] = [0.0, 0.0, 0.5], 0.6
    [changed] = poses(model, rolling(model={"geom_pos": position, "geom_size": size})).parts
    assert changed == {"node": "geom_2", "translation": [0.0, 0.0, 0.5], "scale": [0.6, 0.6, 0.6]}


def test_an_episode_turns_its_geoms() -> None:
    model = model_of(ARM)
    turns = model.geom_quat.copy()
    turns[2] = [0.8, 0.0, 0.6, 0.0]
    [changed] = poses(model, rolling(model={"geom_quat": turns})).parts
    # A replay has the real part last.
    assert changed["rotation"] == [0.0, 0.6, 0.0, 0.8]


@pytest.mark.parametrize(
    ("num_states", "dt", "expected"),
    [
        (5, 0.05, [0, 1, 2, 3, 4]),  # 20 a second: all
        (7, 0.01, [0, 2, 4, 6]),  # 100 a second: each second one
        (6, 0.01, [0, 2, 4, 5]),  # and the last
        (1, 0.01, [0]),  # an episode that ended before its first step
    ],
)
def test_no_more_frames_are_kept_than_are_seen(num_states: int, dt: float, expected: list[int]) -> None:
    assert frame_rows(dt * np.arange(num_states)).tolist() == expected
