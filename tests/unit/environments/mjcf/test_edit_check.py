"""Changes that do not fit their model, each with its place; what the API knows of a model after changes."""

import time
from typing import Any

import mujoco
import pytest

from core.environments.mjcf import holding
from core.environments.mjcf.edit_check import edited, problems
from core.environments.mjcf.edit_options import HOME, ModelEdits
from core.environments.mjcf.edits import edit
from core.environments.terms.describe import inventory
from core.environments.terms.feet import feet_of
from tests.unit.environments.mjcf.test_edits import DOG, FLOOR, MOTORS, SERVO
from tests.unit.environments.mjcf.test_edits import edited as compiled

TARGET = '<body name="target" mocap="true"><geom name="target" size=".1"/></body>'


def parts(more: str = "", world: str = FLOOR) -> mujoco.MjModel:
    spec = mujoco.MjSpec.from_string(DOG.format(world=world, more=more))
    edit(spec, ModelEdits())
    return spec.compile()


PARTS = inventory(parts(MOTORS.replace('ctrlrange="-2 2"', "")))


def test_an_inventory_knows_what_joints_give() -> None:
    # A motor of 2 · 5 N m, and a joint's own limit.
    efforts = {joint.name: joint.effort for joint in inventory(parts(MOTORS)).joints}
    assert efforts == {"trunk free": None, "left_hip": 10, "right_hip": 4, "tail": None}


@pytest.mark.parametrize(
    ("changes", "pointer", "sentence"),
    [
        (
            {"servos": [SERVO, {**SERVO, "joints": ["tail", "left_hop"]}]},
            "/servos/1/joints/0",
            "no hinge or slide that 'tail' matches; it has left_hip, right_hip.",
        ),
        (
            {"servos": [SERVO, {**SERVO, "joints": ["knee.*"]}]},
            "/servos/1/joints/0",
            "it has left_hip, right_hip.",
        ),
        (
            {"servos": [SERVO, {**SERVO, "joints": ["left_.*"]}]},
            "/servos/1/joints",
            "'left_hip' has the servo 0",
        ),
        ({"servos": [{"joints": [".*_hip"]}]}, "/servos/0/kp", "no greatest torque of the joint 'left_hip'"),
        ({"pose": {"joints": {".*_hip": 30}}}, "/pose/joints/.*_hip", "'left_hip' goes from -1.571 to 1.571"),
        ({"pose": {"keyframe": "dwon"}}, "/pose/keyframe", "no keyframe 'dwon'; it has 1, among them up."),
        ({"collide": "feet"}, "/feet", "no foot is named"),
        ({"feet": ["left_foot", "right_fot"]}, "/feet/1", "did you mean 'right_foot'"),
        ({"feet": ["world"]}, "/feet/0", "no body that 'world' matches"),
        ({"collide": "feet", "feet": [".*_foot", "tail"]}, "/feet/1", "'tail' has no geom that can touch"),
        ({"collide": ["left_leg", "left_log"]}, "/collide/1", "did you mean 'left_leg'"),
        ({"primitives": [{"geoms": ["trunc"]}]}, "/primitives/0/geoms/0", "did you mean 'trunk'"),
        ({"pose": {"joints": {"left/hip": 1}}}, "/pose/joints/left~1hip", "did you mean 'left_hip'"),
        (
            {"pose": {"joints": {"left.*": 1, ".*_hip": 0}}},
            "/pose/joints/.*_hip",
            "a position by 'left.*' already",
        ),
    ],
)
def test_what_is_not_there_is_told_with_its_place(
    changes: dict[str, Any], pointer: str, sentence: str
) -> None:
    found = list(problems(ModelEdits.model_validate(changes), PARTS, "/edits"))
    assert found[0].pointer == f"/edits{pointer}"
    assert sentence in found[0].detail
    assert len(found) <= 2


def test_a_model_without_actuators_needs_servos() -> None:
    bare = inventory(parts())
    assert [problem.pointer for problem in problems(ModelEdits(), bare, "/edits")] == ["/edits/servos"]
    assert list(problems(ModelEdits.model_validate({"servos": [SERVO]}), bare, "/edits")) == []


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"floor": True, "servos": [{**SERVO, "joints": [".*"]}], "pose": {"joints": {".*": 0.1}}},
        {"collide": "feet", "feet": [".*_foot"]},
        {"collide": "floor", "servos": [{"joints": ["left.*"]}], "pose": {"keyframe": "up"}},
        {"collide": [".*"]},
    ],
)
@pytest.mark.parametrize("world", [FLOOR, "", FLOOR + TARGET], ids=["floor", "no floor", "mocap"])
def test_the_parts_after_changes_are_those_of_the_compiled_model(changes: dict[str, Any], world: str) -> None:
    edits = ModelEdits.model_validate(changes)
    before = inventory(parts(MOTORS, world))
    assert list(problems(edits, before, "")) == []
    told, true = edited(before, edits), inventory(compiled(changes, world, MOTORS))
    assert told.actuators == true.actuators
    assert told.keyframes == true.keyframes
    assert told.num_pairs == true.num_pairs
    assert sorted(told.geoms) == sorted(true.geoms)
    assert (told.sizes.nu, told.sizes.ngeom) == (true.sizes.nu, true.sizes.ngeom)


def held(changes: dict[str, Any]) -> list[tuple[str, str]]:
    edits = ModelEdits.model_validate(changes)
    return [(each.pointer, each.detail) for each in holding.problems(compiled(changes), edits, "/edits")]


class TestHolding:
    def test_a_pose_in_the_floor_is_told_with_the_height_at_which_it_stands(self) -> None:
        # The ground is at 0.1 m, and the legs with the feet are 0.33 m long.
        ((pointer, detail),) = held({"pose": {"height": 0.4}})
        assert pointer == "/edits/pose/height"
        assert "0.03 m inside the floor: it stands at 0.43" in detail
        assert held({"pose": {"height": 0.43}}) == held({"pose": {}}) == []

    # A leg of 0.3 kg about its end, with a foot of 0.1 kg: 0.3 · 0.3² / 3 + 0.1 · 0.3² = 0.018 kg m², and
    # 0.01 of armature. Were the trunk fixed, explicit damping would blow up at kd · 2 ms / 0.028 kg m² = 2.
    def test_gains_that_blow_up_are_told_with_the_largest_that_do_not(self) -> None:
        servo = {"joints": ["left_hip"], "kp": 2000, "kd": 80, "armature": 0.01}
        before = time.monotonic()
        ((pointer, detail),) = held({"servos": [servo], "integrator": "euler"})
        assert time.monotonic() - before < 4
        assert pointer == "/edits/servos/0/kp"
        assert "'left_hip' does not hold the pose at a timestep of 0.002 s" in detail
        largest = float(detail.split("the largest stable kp is ")[1].split(",")[0])
        damping = float(detail.split("a kd of ")[1].split(" ")[0])
        assert 10 < damping < 30
        assert damping == pytest.approx(80 * (largest / 2000) ** 0.5, rel=0.1)
        assert held({"servos": [{**servo, "kp": largest, "kd": damping}], "integrator": "euler"}) == []
        more = {**servo, "kp": 1.2 * largest, "kd": 1.2**0.5 * damping}
        assert held({"servos": [more], "integrator": "euler"}) != []

    def test_implicit_damping_bears_them(self) -> None:
        assert held({"servos": [{**SERVO, "kp": 2000, "kd": 80}]}) == []

    def test_springs_friction_and_a_servo_without_damping_are_no_explosion(self) -> None:
        assert held({"servos": [{**SERVO, "kd": 0, "damping": 0, "friction_loss": 1}], "pose": {}}) == []


class TestFeet:
    def test_a_ball_is_a_foot_about_its_centre(self) -> None:
        model = compiled({"pose": {"joints": {".*_hip": 0.4}}})
        left, right = feet_of(model, [".*_foot"], model.key(HOME).qpos)
        assert (model.body(left.body).name, model.body(right.body).name) == ("left_foot", "right_foot")
        assert left.point.tolist() == pytest.approx([0, 0, 0], abs=1e-12)
        assert (left.radius, left.ground) == (0.03, pytest.approx(0.1))
        assert [model.geom(geom).name for geom in left.geoms] == ["left_foot geom"]

    def test_another_shape_has_its_sole_where_the_pose_would_rest_on_it(self) -> None:
        model = compiled({"pose": {"height": 3}})
        (left,) = feet_of(model, ["left"], model.key(HOME).qpos)
        # The leg's capsule ends 0.32 m and its ball 0.33 m below the hip: the ball alone is near the floor.
        assert (left.radius, len(left.geoms)) == (0, 2)
        assert left.point.tolist() == pytest.approx([0, 0, -0.33])

    def test_what_touches_nothing_is_at_its_origin(self) -> None:
        model = compiled({})
        (tail,) = feet_of(model, ["tail"], model.qpos0)
        assert (tail.point.tolist(), tail.geoms) == ([0, 0, 0], ())
