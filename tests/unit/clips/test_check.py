"""Each hidden mistake is found in a clip that is otherwise good, and said with its place."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from core.clips.check import Findings, check
from core.clips.clip import Clip
from core.clips.kinematics import lowest, poses, qpos
from core.clips.reading import read
from core.clips.skeleton import aligned, skeleton_of
from core.errors import BadClips
from tests.unit.clips.bodies import JOINTS, WALKER, walker, walking


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return walker()


def with_joint(clip: Clip, name: str, change: Callable[[Any], Any], frames: Any = slice(None)) -> Clip:
    positions = clip.joint_positions.copy()
    column = JOINTS.index(name)
    positions[frames, column] = change(positions[frames, column])
    return replace(clip, joint_positions=positions)


def raised(clip: Clip, by: float) -> Clip:
    return replace(clip, root_position=clip.root_position + np.array([0, 0, by]))


def test_a_good_clip_has_no_findings(model: mujoco.MjModel) -> None:
    assert check(walking(), skeleton_of(model)) == Findings([], [])


NUMERIC: list[tuple[dict[str, Any], str]] = [
    ({"num_frames": 0}, "The clip has no frames"),
    ({"num_frames": 1}, "The clip has one frame"),
    ({"root_orientation": np.zeros((61, 4))}, "In frame 0 the root's quaternion has the length 0, not 1"),
    ({"root_orientation": np.full((61, 4), 0.6)}, "quaternion has the length 1.2, not 1"),
]


@pytest.mark.parametrize(("changes", "sentence"), NUMERIC)
def test_numbers_that_are_no_motion(
    model: mujoco.MjModel, tmp_path: Path, changes: dict[str, Any], sentence: str
) -> None:
    refused(walking(**changes), model, tmp_path, sentence)


def refused(clip: Clip, model: mujoco.MjModel, folder: Path, sentence: str) -> None:
    """The file is refused as a whole."""
    np.savez(
        folder / "clip.npz",
        fps=clip.rate,
        joint_names=np.array(clip.joints),
        joint_pos=np.concatenate([clip.root_position, clip.root_orientation, clip.joint_positions], axis=1),
    )
    with pytest.raises(BadClips, match=sentence):
        read(folder / "clip.npz", model)


def test_nan_is_said_with_frame_and_joint(model: mujoco.MjModel, tmp_path: Path) -> None:
    lost = with_joint(walking(), "left_knee", lambda values: values * np.nan, slice(17, 20))
    refused(
        lost, model, tmp_path, r"In frame 17 joint `left_knee` is NaN; such numbers are in 3 of the frames"
    )


def test_another_bodys_joints_are_named(model: mujoco.MjModel, tmp_path: Path) -> None:
    other = walking(joints=("head", *JOINTS[1:]))
    refused(other, model, tmp_path, "of another body: it lacks `neck`, and the body has no `head`")


def test_a_joint_that_is_there_twice_is_named(model: mujoco.MjModel) -> None:
    with pytest.raises(BadClips, match="has the joint 'neck' twice"):
        aligned(walking(joints=("neck", "neck", *JOINTS[2:])), skeleton_of(model))


BAD: list[tuple[Clip, str]] = [
    (
        replace(walking(), joint_positions=np.degrees(walking().joint_positions)),
        r"Joint `neck` is at .* Taken as degrees, all joints are within their limits: give radians",
    ),
    (
        with_joint(walking(), "left_knee", lambda values: values + 4),
        r"`left_knee` is at 4\.1 rad in frame 0, beyond its limits \[0, 2\.09\]",
    ),
    (
        with_joint(walking(), "left_knee", lambda values: values + 1.5, slice(30, None)),
        r"`left_knee` jumps by 1\.5 rad between the frames 29 and 30, at 45 rad/s: the clip may be cut there",
    ),
    (raised(walking(), -0.12), r"`(left|right)_shin` is 1\d cm under the floor. So is the body in 100%"),
    (
        replace(walking(), root_orientation=walking().root_orientation[:, [1, 2, 3, 0]]),
        r"look like x y z w where w x y z is read: as they are the body leans by \d+°",
    ),
    (
        replace(walking(), root_orientation=walking().root_orientation[:, [3, 0, 1, 2]]),
        r"look like w x y z where x y z w is read: as they are the body leans by \d+°",
    ),
    (
        replace(walking(), root_position=walking().root_position * 1000),
        r"The root is \d+ m high. Taken as millimetres, the body is on the floor: give metres",
    ),
    (
        replace(walking(), root_position=walking().root_position + 20.0 * (np.arange(61) >= 30)[:, None]),
        r"The root jumps by 34\.\d m between the frames 29 and 30",
    ),
]


@pytest.mark.parametrize(("clip", "sentence"), BAD)
def test_what_no_body_does_is_refused(
    model: mujoco.MjModel, tmp_path: Path, clip: Clip, sentence: str
) -> None:
    refused(clip, model, tmp_path, sentence)


def test_a_whole_turn_is_told_as_one() -> None:
    free = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><joint name='axle'/><geom size='0.1'/></body></worldbody></mujoco>"
    )
    angle = np.arange(61) * 0.2
    clip = walking(
        root_position=np.zeros((61, 3)),
        joints=("axle",),
        joint_positions=((angle + np.pi) % (2 * np.pi) - np.pi)[:, None],
    )
    found = check(clip, skeleton_of(free)).problems
    assert len(found) == 1
    assert "a whole turn, so the angle should go on where it passes π" in found[0]


def test_a_body_that_is_fixed_does_not_travel() -> None:
    fixed = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><joint name='neck'/><geom size='0.1'/></body></worldbody></mujoco>"
    )
    clip = walking(joints=("neck",), joint_positions=np.zeros((61, 1)))
    assert "the model's body is fixed to the world" in check(clip, skeleton_of(fixed)).problems[0]


@pytest.mark.parametrize(
    ("clip", "sentence"),
    [
        (raised(walking(), -0.04), "cm under the floor"),
        (raised(walking(), 0.3), "The body never comes nearer to the floor than"),
        (raised(walking(), 20.0), "The body never comes nearer to the floor than"),
        (
            with_joint(walking(), "left_knee", lambda values: values - 0.3),
            r"`left_knee` is at -0.2 rad in frame 0, beyond its limits [0, 2.09]",
        ),
        (
            with_joint(walking(), "left_knee", lambda values: values + 0.9, slice(30, None)),
            "`left_knee` jumps by 0.9 rad between the frames 29 and 30, at 27 rad/s",
        ),
    ],
)
def test_what_may_be_wrong_is_a_warning(model: mujoco.MjModel, clip: Clip, sentence: str) -> None:
    found = check(clip, skeleton_of(model))
    assert found.problems == []
    assert any(sentence in warning for warning in found.warnings), found.warnings


def test_a_body_that_lies_is_no_wrong_order(model: mujoco.MjModel) -> None:
    # On its back: pitched by a quarter turn, 15 cm above the floor.
    back = np.tile([np.cos(np.pi / 4), 0, -np.sin(np.pi / 4), 0], (61, 1))
    lying = walking(root_position=np.tile([0, 0, 0.13], (61, 1)), root_orientation=back)
    still = replace(lying, joint_positions=np.zeros((61, 7)))
    assert check(still, skeleton_of(model)).problems == []
    # On its side: in another order, these quaternions are those of a body that stands.
    side = np.tile([np.cos(np.pi / 4), np.sin(np.pi / 4), 0, 0], (61, 1))
    assert check(replace(still, root_orientation=side), skeleton_of(model)).problems == []


def test_lowest_points_of_each_geom_are_those_of_its_shape() -> None:
    # Each is 1 m high and pitched by 30°: by hand, with half sizes (0.1, 0.2, 0.3) where there are three.
    names = ("sphere", "capsule", "cylinder", "box", "ellipsoid")
    bodies = "".join(
        f"<body pos='0 0 1' euler='0 30 0'><geom type='{name}' size='0.1 0.2 0.3'/></body>" for name in names
    )
    whole = f"<body><freejoint/><inertial pos='0 0 0' mass='1' diaginertia='1 1 1'/>{bodies}</body>"
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{whole}</worldbody></mujoco>")
    skeleton = skeleton_of(model)
    found = lowest(poses(np.asarray(model.qpos0)[None], model), skeleton)[0]
    cos, sin = np.cos(np.pi / 6), np.sin(np.pi / 6)
    down = [
        0.1,
        0.1 + 0.2 * cos,
        0.2 * cos + 0.1 * sin,
        0.1 * sin + 0.3 * cos,
        np.hypot(0.1 * sin, 0.3 * cos),
    ]
    np.testing.assert_allclose(found, 1 - np.array(down), atol=1e-9)


def test_a_model_with_a_ball_joint_has_no_clips() -> None:
    ball = (
        "<mujoco><worldbody><body><joint name='hip' type='ball'/><geom size='1'/></body></worldbody></mujoco>"
    )
    with pytest.raises(BadClips, match="`hip` of this body is a ball joint"):
        skeleton_of(mujoco.MjModel.from_xml_string(ball))


def test_poses_leave_other_bodies_where_they_are() -> None:
    box = '<body pos="2 0 0.2"><freejoint/><geom type="box" size="0.2 0.2 0.2"/></body>'
    torso = '<body name="torso"'
    model = mujoco.MjModel.from_xml_string(WALKER.replace(torso, box + torso))
    skeleton = skeleton_of(model)
    assert skeleton.joints == JOINTS
    rows = qpos(walking(), skeleton)
    np.testing.assert_array_equal(rows[:, :7], np.tile(model.qpos0[:7], (61, 1)))
