"""What the stages cannot move is found, and named."""

import mujoco
import numpy as np
import pytest

from mujoco_compiled.constraints.constraints import read_constraints
from mujoco_compiled.constraints.contact_room import MOST_SLOTS
from mujoco_compiled.coverage import left_out, uncovered
from mujoco_compiled.tests.bodies import brax_model

BODY = """
<mujoco>
  <option {option}/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 1"/>
    <body name="trunk">
      <freejoint name="root"/>
      <geom name="ball" type="{geom}" size="0.1 0.1 0.1"/>
      <body pos="0.3 0 0">
        <joint name="hip" {joint}/>
        <geom type="capsule" size="0.05 0.1" contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <actuator><general joint="hip" {actuator}/></actuator>
</mujoco>
"""


def body(option: str = "", geom: str = "sphere", joint: str = "", actuator: str = "") -> mujoco.MjModel:
    xml = BODY.format(option=option, geom=geom, joint=joint, actuator=actuator)
    return mujoco.MjModel.from_xml_string(xml)


@pytest.mark.parametrize("name", ["ant", "half_cheetah", "hopper", "walker2d", "humanoid", "reacher"])
def test_brax_s_bodies_are_covered(name: str) -> None:
    assert uncovered(brax_model(name)) is None


def test_a_plain_body_is_covered() -> None:
    assert uncovered(body()) is None


@pytest.mark.parametrize(
    ("parts", "named"),
    [
        ({"option": 'integrator="RK4"'}, "rk4"),
        ({"option": 'solver="PGS"'}, "PGS"),
        (
            {"geom": "ellipsoid", "joint": 'limited="true" range="-1 1" solimplimit="0.9 0.95 0.1 0.5 2.2"'},
            "'hip'",
        ),
        (
            {"option": 'integrator="implicitfast" density="1"'},
            "in a fluid, and its integrator is implicitfast",
        ),
        ({"option": 'actuatorgroupdisable="0"'}, "groups of actuators"),
    ],
)
def test_what_is_not_covered_is_named(parts: dict[str, str], named: str) -> None:
    assert named in (uncovered(body(**parts)) or "")


PEBBLE = (
    '<mujoco><option {}/><worldbody><geom type="plane" size="5 5 1" friction="{}"/>{}</worldbody></mujoco>'
)


@pytest.mark.parametrize(
    ("option", "friction", "is_refused"),
    [("", 0.0, True), ("", 0.005, True), ("", 0.02, False), ('cone="elliptic"', 0.0, False)],
)
def test_pyramids_that_single_precision_cannot_compute_are_named(
    option: str, friction: float, *, is_refused: bool
) -> None:
    ball = f'<body><freejoint/><geom name="pebble" size="0.1" friction="{friction}"/></body>'
    reason = uncovered(mujoco.MjModel.from_xml_string(PEBBLE.format(option, friction, ball)))
    assert ("'pebble' can touch with hardly any friction" in (reason or "")) == is_refused


@pytest.mark.parametrize(("offset", "is_refused"), [(0.0, True), (0.001, True), (0.05, False)])
def test_contacts_of_a_body_that_turns_about_its_centre_are_named(offset: float, *, is_refused: bool) -> None:
    # MuJoCo's inverse weight of this contact is 0 where the hinge goes through the centre, and its stiffness
    # 1e15.
    geom = f'<geom name="paddle" type="box" size="0.3 0.1 0.1" pos="0 0 {offset}"/>'
    wheel = f'<body pos="0 0 0.2"><joint axis="0 1 0"/>{geom}</body>'
    reason = uncovered(mujoco.MjModel.from_xml_string(PEBBLE.format("", 1.0, wheel)))
    assert ("'paddle' can touch, but turn about the centres" in (reason or "")) == is_refused


def test_a_body_that_lies_on_more_points_than_there_are_slots_is_refused() -> None:
    balls = "".join(f'<geom size="0.1" pos="{k} 0 0.09"/>' for k in range(MOST_SLOTS + 1))
    model = mujoco.MjModel.from_xml_string(f"""
      <mujoco><worldbody><geom type="plane" size="5 5 1"/>
        <body><freejoint/>{balls}</body>
      </worldbody></mujoco>
    """)
    assert uncovered(model) == "its geoms touch at 513 points where it begins, more than 512"


MESHES = """
<mujoco><asset><mesh name="shell" vertex="{}"/></asset><worldbody>
  <geom type="plane" size="5 5 1"/>
  <body name="trunk"><freejoint/><geom name="trunk" type="mesh" mesh="shell"/>
    <body pos="0 0 1"><joint/><geom size="0.1"/>
      <body pos="0 0 1"><joint/><geom name="shin" type="mesh" mesh="shell"/></body></body>
  </body>
</worldbody>{}</mujoco>
"""


def shells(num_corners: int, more: str = "") -> mujoco.MjModel:
    corners = np.random.default_rng(0).normal(size=(num_corners, 3))
    corners *= 0.1 / np.linalg.norm(corners, axis=1)[:, None]
    return mujoco.MjModel.from_xml_string(MESHES.format(" ".join(f"{x:.5f}" for x in corners.ravel()), more))


def test_meshes_that_pass_through_each_other_are_said() -> None:
    model = shells(20)
    assert uncovered(model) is None
    assert list(left_out(model)) == [
        "its geoms 'trunk' and 'shin' pass through each other, as both are meshes"
    ]
    listed = shells(20, '<contact><pair geom1="trunk" geom2="shin"/></contact>')
    assert "'trunk' and 'shin' can touch: a mesh and a mesh" in (uncovered(listed) or "")
    model.opt.disableflags = mujoco.mjtDisableBit.mjDSBL_CONTACT
    assert list(left_out(model)) == []


def test_meshes_are_known_as_tables() -> None:
    assert read_constraints(shells(20)).are_of_meshes
    assert not read_constraints(body()).are_of_meshes
