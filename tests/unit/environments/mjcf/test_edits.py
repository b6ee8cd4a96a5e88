"""Each change of a model before it is compiled, on models of a few lines."""

from typing import Any

import mujoco
import numpy as np
import pytest
from pydantic import ValidationError

from core.environments.mjcf.edit_options import HOME, Fit, ModelEdits
from core.environments.mjcf.edits import clearance, edit, edits_for_compiled
from core.environments.terms.describe import inventory
from core.errors import JobFailed
from core.patterns import matching
from mujoco_compiled import uncovered

DOG = """
<mujoco>
  <asset><mesh name="brick" vertex="{vertices}"/></asset>
  <worldbody>
    {world}
    <body name="trunk" pos="0 0 1">
      <freejoint/>
      <geom name="trunk" type="mesh" mesh="brick" mass="2"/>
      <body name="left" pos="0 .2 0">
        <joint name="left_hip" axis="0 1 0" range="-90 90" armature=".01" damping=".3"/>
        <geom name="left_leg" type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass=".3"/>
        <body name="left_foot" pos="0 0 -.3"><geom size=".03" mass=".1"/></body>
      </body>
      <body name="right" pos="0 -.2 0">
        <joint name="right_hip" axis="0 1 0" actuatorfrcrange="-4 4"/>
        <geom name="right_leg" type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass=".3"/>
        <body name="right_foot" pos="0 0 -.3"><geom size=".03" mass=".1"/></body>
        <body name="tail"><joint name="tail" type="ball"/><geom size=".01" mass=".01" contype="0"
          conaffinity="0"/></body>
      </body>
    </body>
  </worldbody>
  {more}
</mujoco>
""".replace(
    "{vertices}", " ".join(f"{x} {y} {z}" for x in (-0.2, 0.2) for y in (-0.1, 0.1) for z in (-0.05, 0.05))
)
MOTORS = """
<actuator>
  <motor name="pull" joint="left_hip" gear="5" ctrlrange="-2 2"/>
  <general name="second" joint="left_hip" dyntype="filter" dynprm="1"/>
  <motor name="tail" joint="tail"/>
</actuator>
<sensor><actuatorfrc name="felt" actuator="pull"/><actuatorfrc actuator="second"/></sensor>
<keyframe><key name="up" qpos="0 0 2 1 0 0 0 .1 .1 1 0 0 0" ctrl=".2 0 0" act="0"/></keyframe>
"""
FLOOR = '<geom name="ground" type="plane" size="1 1 1" pos="0 0 .1" friction=".9"/>'


def edited(changes: dict[str, Any], world: str = FLOOR, more: str = "") -> mujoco.MjModel:
    spec = mujoco.MjSpec.from_string(DOG.format(world=world, more=more))
    edit(spec, ModelEdits.model_validate(changes))
    return spec.compile()


def touching(model: mujoco.MjModel) -> set[frozenset[str]]:
    """The pairs of geoms that touch where everything is in one place."""
    masks = [(model.geom_contype[geom], model.geom_conaffinity[geom]) for geom in range(model.ngeom)]
    return {
        frozenset((model.geom(one).name, model.geom(other).name))
        for one in range(model.ngeom)
        for other in range(one)
        if masks[one][0] & masks[other][1] or masks[other][0] & masks[one][1]
    }


SERVO = {"joints": [".*_hip"], "kp": 20, "kd": 1.5}


class TestServos:
    def test_they_take_the_place_of_motors_and_come_where_there_are_none(self) -> None:
        model = edited({"servos": [{**SERVO, "armature": 0.02, "damping": 0}]}, more=MOTORS)
        assert [model.actuator(number).name for number in range(model.nu)] == ["pull", "tail", "right_hip"]
        for name in ("pull", "right_hip"):
            servo = model.actuator(name)
            assert servo.gainprm[0] == 20
            assert servo.biasprm[:3].tolist() == [0, -20, -1.5]
            assert servo.gear[0] == 1
            assert not servo.ctrllimited[0]
        # The motor's 2 · 5 N m; the joint's own limit of 4 where there is no motor.
        assert model.actuator("pull").forcerange.tolist() == [-10, 10]
        assert model.actuator("right_hip").forcerange.tolist() == [-4, 4]
        assert model.actuator("tail").gainprm[0] == 1
        assert model.na == 0
        assert model.dof_armature[model.joint("left_hip").dofadr[0]] == 0.02
        assert model.dof_damping[6:].tolist() == [0] * 5
        # What read the motor's force reads the servo's.
        assert [model.sensor(number).name for number in range(model.nsensor)] == ["felt"]
        assert model.key_qpos[0, 7] == 0.1
        assert not model.key_ctrl.any()

    def test_what_is_not_said_stays(self) -> None:
        model = edited({"servos": [{**SERVO, "joints": ["left_hip"], "effort": 3}]}, more=MOTORS)
        assert model.actuator("pull").forcerange.tolist() == [-3, 3]
        left = model.joint("left_hip").dofadr[0]
        assert (model.dof_armature[left], model.dof_damping[left]) == (0.01, 0.3)
        assert model.nu == 2

    def test_gains_follow_from_the_effort(self) -> None:
        # The motor's 2 · 5 N m, twice per rad, and a 25th of it per rad/s.
        servo = edited({"servos": [{"joints": ["left_hip"]}]}, more=MOTORS).actuator("pull")
        assert -servo.biasprm[1:3] == pytest.approx([20, 0.8])
        stiff = edited({"servos": [{"joints": ["left_hip"], "kp": 50}]}, more=MOTORS).actuator("pull")
        assert -stiff.biasprm[1:3] == pytest.approx([50, 2])
        with pytest.raises(JobFailed, match="'left_hip': a servo needs a kp"):
            edited({"servos": [{"joints": ["left_hip"]}]})

    def test_a_ball_has_no_servo(self) -> None:
        model = edited({"servos": [{**SERVO, "joints": [".*"]}]})
        assert [model.actuator(number).name for number in range(model.nu)] == ["left_hip", "right_hip"]

    def test_its_force_is_a_springs_within_its_effort(self) -> None:
        model = edited({"servos": [{**SERVO, "effort": 8}]})
        data = mujoco.MjData(model)
        data.joint("left_hip").qvel, data.ctrl[:] = 0.5, [0.1, 1]
        mujoco.mj_forward(model, data)
        # 20 · 0.1 - 1.5 · 0.5; and 20 · 1 is more than 8.
        assert data.actuator_force.tolist() == pytest.approx([1.25, 8])


class TestCollisions:
    def test_feet_touch_the_world_alone(self) -> None:
        model = edited({"collide": "feet", "feet": [".*_foot"]})
        assert touching(model) == {frozenset(("ground", f"{side}_foot geom")) for side in ("left", "right")}

    def test_what_is_welded_to_a_foot_belongs_to_it(self) -> None:
        model = edited({"collide": "feet", "feet": ["left"]})
        assert touching(model) == {frozenset(("ground", "left_leg")), frozenset(("ground", "left_foot geom"))}

    def test_everything_touches_the_floor_alone(self) -> None:
        names = ("trunk", "left_leg", "right_leg", "left_foot geom", "right_foot geom")
        assert touching(edited({"collide": "floor"})) == {frozenset(("ground", name)) for name in names}
        assert inventory(edited({"collide": "floor"})).num_pairs == 5
        # Two parts of each leg meet two of the other; a leg and the trunk that it hangs on never do.
        assert inventory(edited({})).num_pairs == 5 + 4

    def test_geoms_are_chosen_by_pattern(self) -> None:
        model = edited({"collide": [".*_leg", "tail geom"]})
        assert touching(model) == {
            frozenset(("ground", name)) for name in ("left_leg", "right_leg", "tail geom")
        }

    def test_pairs_stay_where_a_chosen_geom_meets_the_world(self) -> None:
        pairs = (
            '<contact><pair geom1="left_leg" geom2="ground" condim="1"/>'
            '<pair geom1="left_leg" geom2="right_leg"/></contact>'
        )
        assert edited({"collide": "floor"}, more=pairs).npair == 1
        assert edited({"collide": "feet", "feet": [".*_foot"]}, more=pairs).npair == 0
        assert edited({}, more=pairs).npair == 2

    def test_friction_is_that_of_the_moving_geoms(self) -> None:
        model = edited({"friction": 0.4})
        data = mujoco.MjData(model)
        data.qpos[2] = 0.4
        mujoco.mj_forward(model, data)
        assert {round(float(contact.friction[0]), 6) for contact in data.contact} == {0.4}

    def test_a_floor_comes_where_there_is_none(self) -> None:
        assert edited({"floor": True}).ngeom == edited({}).ngeom
        model = edited({"floor": True}, world='<geom name="floor" size=".1" contype="0" conaffinity="0"/>')
        assert model.geom("floor 2").type[0] == mujoco.mjtGeom.mjGEOM_PLANE
        assert model.ngeom == edited({}).ngeom + 1


def test_what_compiled_refuses_is_told_with_the_change_that_helps() -> None:
    # Its legs meet each other without friction.
    spec = mujoco.MjSpec.from_string(DOG.format(world=FLOOR, more=""))
    spec.geom("left_leg").friction = spec.geom("right_leg").friction = [0.0, 0.0, 0.0]
    assert uncovered(spec.copy().compile()) is not None
    assert edits_for_compiled(spec) == ModelEdits.model_validate({"floor": True, "collide": "floor"})
    assert spec.compile().nexclude == 0
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    assert edits_for_compiled(spec) is None


class TestPrimitives:
    @pytest.mark.parametrize(
        ("shape", "size"),
        [("box", [0.2, 0.1, 0.05]), ("ellipsoid", [0.2, 0.1, 0.05]), ("sphere", [0.2]), ("capsule", None)],
    )
    def test_a_colliding_mesh_is_fitted_and_still_drawn(self, shape: str, size: list[float] | None) -> None:
        model = edited({"primitives": [{"shape": shape}]})
        fitted = model.geom("trunk")
        assert fitted.type[0] == getattr(mujoco.mjtGeom, f"mjGEOM_{shape.upper()}")
        if size is not None:
            assert sorted(fitted.size[: len(size)], reverse=True) == pytest.approx(size)
        drawn = [geom for geom in range(model.ngeom) if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH]
        assert [model.geom_conaffinity[geom] for geom in drawn] == [0]

    def test_masses_and_inertias_stay(self) -> None:
        plain, fitted = edited({}), edited({"primitives": [{"shape": "sphere"}]})
        np.testing.assert_allclose(fitted.body_mass, plain.body_mass)
        np.testing.assert_allclose(fitted.body_inertia, plain.body_inertia, rtol=1e-6)
        np.testing.assert_allclose(fitted.body_ipos, plain.body_ipos, atol=1e-12)

    def test_the_first_that_names_a_mesh_counts(self) -> None:
        fits = [Fit(geoms=["trunk"], shape="capsule"), Fit(shape="box")]
        model = edited({"primitives": [fit.model_dump() for fit in fits]})
        assert model.geom("trunk").type[0] == mujoco.mjtGeom.mjGEOM_CAPSULE


class TestPose:
    def test_it_rests_on_what_it_touches(self) -> None:
        model = edited({"servos": [SERVO], "pose": {"joints": {".*_hip": 0.5}}})
        qpos = model.key(HOME).qpos
        assert qpos[7:9].tolist() == model.key(HOME).ctrl.tolist() == [0.5, 0.5]
        # A foot is 0.3 m down the leg and 0.03 m thick, and the ground at 0.1 m.
        assert qpos[2] == pytest.approx(0.1 + 0.03 + 0.3 * np.cos(0.5))
        assert clearance(model, qpos) == pytest.approx(0, abs=1e-9)

    def test_it_may_follow_a_keyframe(self) -> None:
        keyframe = MOTORS.replace('name="up"', 'name="home"')
        with pytest.raises(JobFailed, match="no keyframe 'home'"):
            edited({"pose": {"keyframe": "home"}}, more=MOTORS)
        model = edited({"pose": {"keyframe": "home", "joints": {"right_hip": -0.2}}}, more=keyframe)
        assert model.nkey == 1
        assert model.key(HOME).qpos[7:9].tolist() == [0.1, -0.2]
        assert clearance(model, model.key(HOME).qpos) == pytest.approx(0, abs=1e-9)

    def test_its_height_may_be_given(self) -> None:
        model = edited({"pose": {"height": 0.2}})
        assert model.key(HOME).qpos[2] == 0.2
        assert clearance(model, model.key(HOME).qpos) == pytest.approx(0.2 - 0.1 - 0.33)

    def test_it_replaces_a_keyframe_of_its_name(self) -> None:
        model = edited({"pose": {}}, more=MOTORS.replace('name="up"', 'name="home"'))
        assert model.nkey == 1
        assert model.key(HOME).qpos[7] == 0


class TestPatterns:
    def test_they_match_whole_names(self) -> None:
        names = ["hip", "hip_left", "knee(1)", ""]
        assert matching(["hip"], names) == ["hip"]
        assert matching(["hip.*"], names) == ["hip", "hip_left"]
        assert matching(["knee(1)"], names) == [
            "knee(1)"
        ]  # A name is itself, whatever it means as a pattern.
        assert matching(["a|hip", ".*"], names) == names[:3]
        assert matching([r"foot\d_[\w]+\."], ["foot1_in.", "footx_in.", "foot٣_in."]) == ["foot1_in."]

    @pytest.mark.parametrize(
        ("pattern", "why"),
        [
            ("(", "unclosed"),
            ("a)|(b", "unopened"),
            ("(?=a)", "look"),
            ("(?i)a", "flag"),
            (r"(a)\1", "back"),
            (r"\pL", "letters"),
            ("a{9}", "count"),
        ],
    )
    def test_what_is_none_is_refused(self, pattern: str, why: str) -> None:
        with pytest.raises(ValidationError, match=why):
            ModelEdits.model_validate({"feet": [pattern]})

    def test_none_takes_long(self) -> None:
        # Backtracking would try 2^60 ways.
        assert matching([f"{'(a|a)*' * 25}b"], ["a" * 60]) == []
