"""What the stages cannot move is found, and named."""

import mujoco
import pytest

from core.physics.model import brax_model
from mujoco_compiled.coverage import MOST_POINTS, uncovered

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


def test_more_points_than_there_is_room_for_are_refused() -> None:
    balls = "".join(f'<geom size="0.1" pos="{k} 0 0" condim="6"/>' for k in range(2_001))
    model = mujoco.MjModel.from_xml_string(f"""
      <mujoco><worldbody><geom type="plane" size="5 5 1"/>
        <body><freejoint/>{balls}</body>
      </worldbody></mujoco>
    """)
    assert f"more than {MOST_POINTS:,}" in (uncovered(model) or "")
