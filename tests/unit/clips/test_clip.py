"""Changes of a clip in time, by numbers that follow from its motion."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from core.clips import clip as clips
from core.clips import quaternions
from core.clips.clip import Clip


def turning(rate: float = 10.0, num_frames: int = 11, *, speed: float = 2.0, **changes: Any) -> Clip:
    """It moves by 0.3 m/s in x, turns by `speed` rad/s about z, and bends its knee by 1 rad/s."""
    time = np.arange(num_frames) / rate
    zero = np.zeros_like(time)
    half = speed * time / 2
    parts: dict[str, Any] = {
        "name": "turn",
        "rate": rate,
        "root_position": np.stack([0.3 * time, zero, zero + 1], axis=1),
        "root_orientation": np.stack([np.cos(half), zero, zero, np.sin(half)], axis=1),
        "joints": ("knee",),
        "joint_positions": time[:, None],
    }
    return Clip(**parts | changes)


def test_velocities_are_those_of_the_motion() -> None:
    moving = clips.with_velocities(turning())
    np.testing.assert_allclose(moving.root_linear_velocity, np.tile([0.3, 0, 0], (11, 1)), atol=1e-12)
    np.testing.assert_allclose(moving.root_angular_velocity, np.tile([0, 0, 2.0], (11, 1)), atol=1e-12)
    np.testing.assert_allclose(moving.joint_velocities, np.ones((11, 1)), atol=1e-12)


def test_angular_velocity_is_in_the_roots_own_frame() -> None:
    # Lying on its side, x up (a quarter turn about -y: x goes to z), it turns about the world's z: its own x.
    side = np.tile([np.cos(np.pi / 4), 0, -np.sin(np.pi / 4), 0], (11, 1))
    lying = turning(root_orientation=quaternions.multiply(turning().root_orientation, side))
    found = clips.with_velocities(lying).root_angular_velocity
    np.testing.assert_allclose(found, np.tile([2.0, 0, 0], (11, 1)), atol=1e-12)


def test_a_quaternion_and_its_negative_are_one_orientation() -> None:
    flipped = turning()
    flipped.root_orientation[::2] *= -1
    found = clips.with_velocities(flipped).root_angular_velocity
    np.testing.assert_allclose(found, np.tile([0, 0, 2.0], (11, 1)), atol=1e-12)


def test_velocities_at_the_inside_are_central_differences() -> None:
    # x = t²: the central difference at t is 2t exactly; at the ends it is of one side.
    time = np.arange(5) / 10
    squared = turning(num_frames=5, joint_positions=(time**2)[:, None])
    found = clips.with_velocities(squared).joint_velocities
    assert found is not None
    np.testing.assert_allclose(found[:, 0], [0.1, 0.2, 0.4, 0.6, 0.7], atol=1e-12)


def test_own_velocities_are_kept() -> None:
    own = turning(
        root_linear_velocity=np.full((11, 3), 7.0),
        root_angular_velocity=np.zeros((11, 3)),
        joint_velocities=np.zeros((11, 1)),
    )
    assert clips.with_velocities(own) is own


def test_one_frame_has_no_velocity() -> None:
    with pytest.raises(ValueError, match="'turn' has 1 frames: velocities need two"):
        clips.with_velocities(turning(num_frames=1))


def test_resampled_frames_lie_on_the_motion() -> None:
    found = clips.resampled(turning(), 25.0)  # 1 s: 26 frames
    expected = turning(25.0, 26)
    assert (found.rate, found.num_frames, found.duration_s) == (25.0, 26, 1.0)
    for name, values in clips.arrays(expected).items():
        np.testing.assert_allclose(getattr(found, name), values, atol=1e-12, err_msg=name)


def test_resampling_ends_before_the_clip_does() -> None:
    found = clips.resampled(turning(num_frames=10), 4.0)  # 0.9 s: at 0, 0.25, 0.5, 0.75
    np.testing.assert_allclose(found.joint_positions[:, 0], [0, 0.25, 0.5, 0.75], atol=1e-12)


def test_resampling_turns_the_shorter_way() -> None:
    # 0 and 350 degrees about z: half way is -5 degrees.
    turns = np.radians([0.0, 350.0])
    orientation = np.stack([np.cos(turns / 2), 0 * turns, 0 * turns, np.sin(turns / 2)], axis=1)
    found = clips.resampled(turning(num_frames=2, root_orientation=orientation), 20.0)
    np.testing.assert_allclose(quaternions.rotation_vector(found.root_orientation[1]), [0, 0, -np.radians(5)])


def test_cut_takes_whole_frames_with_both_ends() -> None:
    found = clips.cut(turning(), 0.31, 0.52)  # frames 3 to 5
    np.testing.assert_allclose(found.joint_positions[:, 0], [0.3, 0.4, 0.5])
    assert clips.cut(turning(), to_s=9.0).num_frames == 11


@pytest.mark.parametrize(("from_s", "to_s"), [(0.5, 0.5), (2.0, None), (0.51, 0.54)])
def test_a_cut_that_leaves_nothing_is_refused(from_s: float, to_s: float | None) -> None:
    with pytest.raises(ValueError, match="fewer than two frames: it lasts 1 s at 10 frames per second"):
        clips.cut(turning(), from_s, to_s)


def test_sped_up_has_the_velocities_of_its_motion() -> None:
    faster = clips.sped_up(clips.with_velocities(turning()), 2.0)
    assert faster.duration_s == 0.5
    anew = clips.with_velocities(clips.without_velocities(faster))
    for name, values in clips.arrays(anew).items():
        np.testing.assert_allclose(getattr(faster, name), values, atol=1e-12, err_msg=name)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"rate": 0.0}, "0 frames per second"),
        ({"rate": float("nan")}, "nan frames per second"),
        ({"joint_positions": np.zeros((11, 2))}, r"`joint_positions` of the clip 'turn' .* \[11, 1\]"),
        ({"root_orientation": np.zeros((10, 4))}, r"`root_orientation` .* \[10, 4\], not \[11, 4\]"),
        ({"joint_velocities": np.zeros((11, 1))}, "some of its velocities and lacks others"),
    ],
)
def test_a_clip_has_a_rate_and_arrays_that_fit(changes: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        replace(turning(), **changes)
