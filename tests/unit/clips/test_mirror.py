"""A mirrored clip, beside the reflection of where MuJoCo puts the body."""

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest

from core.clips.clip import arrays, with_velocities, without_velocities
from core.clips.kinematics import poses, qpos
from core.clips.mirror import mirror_of, mirrored
from core.clips.skeleton import Skeleton, skeleton_of
from core.errors import BadClips
from tests.unit.clips.bodies import JOINTS, WALKER, walking

ACROSS = np.array([1.0, -1.0, 1.0])


def turned_walker() -> str:
    """Its root's y axis points up, as that of dm_control's humanoid: the side is another of its axes."""
    body, joint = '<body name="torso" pos="0 0 0.95">', '<freejoint name="root"/>'
    head, foot = WALKER.split(joint)
    inner = foot.replace("</body>\n  </worldbody>", "</body></body>\n  </worldbody>")
    frame = (
        f'<body name="hips" euler="90 0 90">{joint}<geom size="0.01"/><body name="torso" euler="0 -90 -90">'
    )
    return head.replace(body, frame) + inner


def random_clip(skeleton: Skeleton, **changes: Any) -> Any:
    random = np.random.default_rng(0)
    num_joints = len(skeleton.joints)
    turns = random.normal(size=(5, 4))
    return walking(
        num_frames=5,
        root_position=random.normal(size=(5, 3)),
        root_orientation=turns / np.linalg.norm(turns, axis=1, keepdims=True),
        joints=skeleton.joints,
        joint_positions=random.uniform(-1, 1, (5, num_joints)),
        **changes,
    )


@pytest.mark.parametrize("xml", [WALKER, turned_walker()], ids=["walker", "turned"])
def test_bodies_lie_where_a_mirror_shows_them(xml: str) -> None:
    model = mujoco.MjModel.from_xml_string(xml)
    skeleton = skeleton_of(model)
    clip = random_clip(skeleton)
    there = poses(qpos(mirrored(clip, mirror_of(skeleton)), skeleton), model).body_positions
    here = poses(qpos(clip, skeleton), model).body_positions
    names = [model.body(body).name for body in range(1, model.nbody)]
    for name in names:
        other = name.replace("left", "?").replace("right", "left").replace("?", "right")
        np.testing.assert_allclose(
            there[:, model.body(other).id], here[:, model.body(name).id] * ACROSS, atol=1e-9, err_msg=name
        )


@pytest.mark.parametrize("xml", [WALKER, turned_walker()], ids=["walker", "turned"])
def test_mirrored_twice_is_the_clip(xml: str) -> None:
    skeleton = skeleton_of(mujoco.MjModel.from_xml_string(xml))
    clip, mirror = with_velocities(random_clip(skeleton)), mirror_of(skeleton)
    again = mirrored(mirrored(clip, mirror), mirror)
    same_sign = np.sign(np.sum(again.root_orientation * clip.root_orientation, axis=1, keepdims=True))
    again = replace(again, root_orientation=again.root_orientation * same_sign)
    for name, values in arrays(clip).items():
        np.testing.assert_allclose(getattr(again, name), values, atol=1e-9, err_msg=name)


@pytest.mark.parametrize("xml", [WALKER, turned_walker()], ids=["walker", "turned"])
def test_velocities_are_those_of_the_mirrored_motion(xml: str) -> None:
    skeleton = skeleton_of(mujoco.MjModel.from_xml_string(xml))
    found = mirrored(with_velocities(random_clip(skeleton)), mirror_of(skeleton))
    anew = with_velocities(without_velocities(found))
    for name, values in arrays(anew).items():
        np.testing.assert_allclose(getattr(found, name), values, atol=1e-9, err_msg=name)


def test_signs_follow_from_the_axes() -> None:
    mirror = mirror_of(skeleton_of(mujoco.MjModel.from_xml_string(WALKER)))
    partners = {name: JOINTS[place] for name, place in zip(JOINTS, mirror.partners, strict=True)}
    assert partners["left_hip_pitch"] == "right_hip_pitch"
    assert partners["right_knee"] == "left_knee"
    assert partners["neck"] == "neck"
    # About z and x the other way round; about y the same way, but the right knee's axis is -y.
    assert dict(zip(JOINTS, mirror.signs, strict=True)) == {
        "neck": -1,
        "left_hip_pitch": 1,
        "left_hip_roll": -1,
        "left_knee": -1,
        "right_hip_pitch": 1,
        "right_hip_roll": -1,
        "right_knee": -1,
    }


@pytest.mark.parametrize(
    ("change", "joint"),
    [
        (
            ('<body name="right_thigh" pos="0 -0.1 -0.1">', '<body name="right_thigh" pos="0 -0.14 -0.1">'),
            "left_hip",
        ),
        (('name="right_knee" axis="0 -1 0"', 'name="right_knee" axis="0 -1 1"'), "left_knee"),
        (('<body name="head" pos="0 0 0.35">', '<body name="head" pos="0 0.05 0.35">'), "neck"),
    ],
)
def test_a_body_that_is_not_symmetric_is_refused_with_a_joint(change: tuple[str, str], joint: str) -> None:
    skeleton = skeleton_of(mujoco.MjModel.from_xml_string(WALKER.replace(*change)))
    with pytest.raises(BadClips, match=f"not symmetric.* no joint is the mirror image of `{joint}"):
        mirror_of(skeleton)


def test_a_planar_body_is_its_own_mirror_image() -> None:
    planar = """
    <mujoco><worldbody><body name="torso" pos="0 0 1">
      <joint name="rootx" type="slide" axis="1 0 0"/><joint name="rooty" axis="0 1 0"/><geom size="0.1"/>
      <body pos="0 0 -0.3"><joint name="hip" axis="0 -1 0" ref="20"/><geom size="0.1"/></body>
    </body></worldbody></mujoco>
    """
    mirror = mirror_of(skeleton_of(mujoco.MjModel.from_xml_string(planar)))
    assert (mirror.partners.tolist(), mirror.signs.tolist(), mirror.offsets.tolist()) == (
        [0, 1, 2],
        [1, 1, 1],
        [0, 0, 0],
    )
