"""Passive forces, actuators and integrators against C MuJoCo, without contacts."""

from dataclasses import dataclass, replace

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from mujoco_compiled.coverage import uncovered, uncovered_own
from mujoco_compiled.program.arithmetic import Vector, add
from mujoco_compiled.smooth.actuation import ActuatorState, actuator_stretch, driven
from mujoco_compiled.smooth.dynamics import mass_matrix, motion, projected
from mujoco_compiled.smooth.fluid import drag_forces
from mujoco_compiled.smooth.forces import passive_forces, weight_held
from mujoco_compiled.smooth.kinematics import poses
from mujoco_compiled.smooth.paths import Posture
from mujoco_compiled.smooth.spatial import rotation_vector
from mujoco_compiled.smooth.tendons import tendon_forces, with_armature, with_tendons
from mujoco_compiled.substep import Model, SubstepState, control_step, read_model, substep
from mujoco_compiled.tests.recorded_substep import recorded
from mujoco_compiled.tests.rows_of_mujoco import assert_same_rows
from mujoco_compiled.tests.states import THOROUGH, converge

NUM_STATES = 8
PULLED = """
<mujoco>
  <option timestep="0.005" {option}><flag {flag}/></option>
  <default><geom contype="0" conaffinity="0"/></default>
  <worldbody>
    <body name="trunk" pos="0 0 1">
      <joint name="root" type="free" stiffness="3"/>
      <geom type="box" size="0.1 0.2 0.3" pos="0.1 0 0.2" euler="10 20 30"/>
      <body name="arm" pos="0.2 0.1 0" euler="30 0 60" gravcomp="0.7">
        <joint name="shoulder" type="ball" pos="0 0.1 0.05" stiffness="5" damping="0.3"/>
        <geom type="ellipsoid" size="0.1 0.05 0.2" pos="0 0 0.1"/>
        <body name="hand" pos="0 0 0.4" gravcomp="1.5">
          <joint name="wrist" axis="1 2 0" pos="0.1 0 0" springref="20" stiffness="2" damping="0.1"
            actuatorfrcrange="-0.5 0.5"/>
          <joint name="reach" type="slide" axis="0 1 1" stiffness="1" armature="0.1" actuatorgravcomp="true"/>
          <geom type="capsule" size="0.05 0.2" mass="0.7"/>
        </body>
      </body>
      <body name="leg" pos="0 0 -0.3">
        <joint name="hip" axis="0 1 0" damping="0.02"/><geom type="capsule" size="0.05 0.2"/>
      </body>
    </body>
  </worldbody>
  <tendon>
    <fixed name="both" stiffness="2" damping="0.3" armature="0.2" springlength="-0.5 0.5"
      actuatorfrcrange="-1.5 1">
      <joint joint="wrist" coef="0.5"/><joint joint="reach" coef="-2"/></fixed>
    <fixed name="across" stiffness="1" armature="0.1">
      <joint joint="hip" coef="0.5"/><joint joint="reach" coef="1.5"/></fixed>
  </tendon>
  <actuator>
    <motor joint="root" gear="1 2 3 4 5 6"/>
    <velocity joint="shoulder" gear="1 0 -2" kv="0.1"/>
    <position joint="wrist" kp="20" kv="0.2" ctrlrange="-1 1" forcerange="-3 3"/>
    <position joint="hip" kp="3" timeconst="0.1" gear="2" inheritrange="0"/>
    <intvelocity joint="reach" kp="5" kv="0.1" actrange="-0.6 0.6"/>
    <general joint="hip" dyntype="filter" dynprm="0.05" gaintype="affine" gainprm="1 2 -0.5" actearly="true"/>
    <general tendon="both" gear="-2" dyntype="filterexact" dynprm="0.02" biastype="affine" biasprm="1 -2 -1"/>
    <motor tendon="both" gear="3"/>
    <general tendon="across" gaintype="affine" gainprm="1 0 -2" ctrlrange="-0.2 0.2" forcerange="-0.3 0.3"/>
  </actuator>
</mujoco>
"""


def pulled(option: str = "", flag: str = "") -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(PULLED.format(option=option, flag=flag))


def random_states(model: mujoco.MjModel, spread: float = 1.0) -> list[mujoco.MjData]:
    generator = np.random.default_rng(0)
    datas = [mujoco.MjData(model) for _ in range(NUM_STATES)]
    for data in datas:
        data.qpos[:] += spread * generator.normal(size=model.nq)
        data.qvel[:] = spread * generator.normal(size=model.nv)
        data.act[:] = spread * generator.normal(size=model.na)
        data.ctrl[:] = generator.normal(size=model.nu)
        mujoco.mj_forward(model, data)
    return datas


def of_all(datas: list[mujoco.MjData], field: str) -> Vector:
    return list(np.stack([getattr(data, field) for data in datas], axis=1))


def state_of(datas: list[mujoco.MjData]) -> SubstepState:
    return SubstepState(*(of_all(datas, field) for field in ("qpos", "qvel", "act", "qacc_warmstart")))


def assert_close(ours: Vector, theirs: Vector, accuracy: float = 1e-12) -> None:
    expected = np.stack(theirs)
    found = np.stack([np.broadcast_to(x, expected.shape[1:]) for x in ours])
    np.testing.assert_allclose(
        found, expected, rtol=0, atol=accuracy * max(1.0, float(np.abs(expected).max()))
    )


@dataclass(frozen=True)
class Forces:
    """passive, actuator: [nv]. mass: M [NUM_STATES, nv, nv]."""

    passive: Vector
    actuator: Vector
    act: Vector
    mass: NDArray[np.float64]


def forces_of(model: Model, state: SubstepState, ctrl: Vector) -> Forces:
    tree = model.tree
    at = poses(tree, state.qpos)
    moving = motion(tree, at, state.qvel)
    held = weight_held(tree, at, moving)
    posture = with_tendons(Posture(tree, at, moving, state.qpos), model.tendons)
    passive = add(
        passive_forces(tree, state.qpos, state.qvel),
        tendon_forces(model.tendons, posture.tendons, state.qvel),
    )
    passive = add(passive, projected(tree, moving, drag_forces(tree, model.fluid, at, moving)))
    for i, dof in enumerate(tree.dofs):
        passive[i] = passive[i] + (held[i] if held and not dof.holds_weight else 0.0)
    along = [actuator_stretch(actuator.path, posture) for actuator in model.actuators]
    own = ActuatorState(along, state.qvel, state.act, ctrl, held)
    done = driven(tree, model.actuators, own, model.timestep)
    mass = np.zeros((NUM_STATES, len(tree.dofs), len(tree.dofs)))
    for (i, j), entry in with_armature(model.tendons, posture.tendons, mass_matrix(tree, moving)).items():
        mass[:, i, j] = mass[:, j, i] = entry
    return Forces(passive, done.on_dofs, done.act, mass)


def assert_forces_are_mujoco_s(model: mujoco.MjModel, datas: list[mujoco.MjData]) -> None:
    ours = forces_of(read_model(model), state_of(datas), of_all(datas, "ctrl"))
    assert_close(ours.passive, of_all(datas, "qfrc_passive"))
    assert_close(ours.actuator, of_all(datas, "qfrc_actuator"))
    theirs = np.zeros_like(ours.mass)
    for data, dense in zip(datas, theirs, strict=True):
        mujoco.mj_fullM(model, data, dense)
        mujoco.mj_step(model, data)
    assert_close(list(ours.mass), list(theirs))
    if model.na:
        assert_close(ours.act, of_all(datas, "act"))


@pytest.mark.parametrize(
    ("option", "flag"),
    [
        ("", ""),
        ('density="1000" viscosity="0.3" wind="1 2 -1"', ""),
        ("", 'spring="disable"'),
        ("", 'damper="disable"'),
        ('density="1000"', 'spring="disable" damper="disable"'),
        ("", 'gravity="disable"'),
        ("", 'clampctrl="disable"'),
        ("", 'actuation="disable"'),
    ],
)
def test_forces_are_mujoco_s(option: str, flag: str) -> None:
    model = pulled(option, flag)
    assert uncovered(model) is None
    assert_forces_are_mujoco_s(model, random_states(model))


@pytest.mark.parametrize(
    ("mine", "other", "reason"),
    [
        ('<velocity joint="shoulder"', '<position joint="shoulder"', "holds a joint with several axes"),
        ("<velocity joint", "<velocity jointinparent", "in its parent's frame"),
    ],
)
def test_what_pulls_otherwise_is_named(mine: str, other: str, reason: str) -> None:
    xml = PULLED.format(option="", flag="").replace(mine, other)
    assert reason in (uncovered(mujoco.MjModel.from_xml_string(xml)) or "")


@pytest.mark.parametrize(
    ("option", "flag"),
    [
        ("", ""),
        ("", 'eulerdamp="disable"'),
        ('integrator="implicitfast"', ""),
        ('integrator="implicitfast"', 'damper="disable" warmstart="disable"'),
        ('density="100" viscosity="0.1"', 'gravity="disable"'),
    ],
)
def test_a_body_without_contacts_moves_as_in_mujoco(option: str, flag: str) -> None:
    model = pulled(option, flag)
    datas = random_states(model, 0.3)
    ours, state, ctrl = read_model(model), state_of(datas), of_all(datas, "ctrl")
    after = control_step(ours, 20, state, ctrl, reads_forces=True)
    for number in range(20):
        for data in datas:
            mujoco.mj_step(model, data)
        if number == 0:
            assert_close(substep(ours, state, ctrl).qvel, of_all(datas, "qvel"))
    for field in ("qpos", "qvel", "act", "qfrc_actuator"):
        assert_close(getattr(after, field), of_all(datas, field), 1e-9)


SITES = """
<mujoco>
  <option {option}/>
  <default><geom contype="0" conaffinity="0"/></default>
  <worldbody>
    <site name="still" pos="1 2 3" euler="20 30 40"/>
    <body pos="0 0 1"><freejoint/><geom type="box" size="0.1 0.2 0.3"/>
      <site name="back" pos="0.1 0.2 0.3" euler="50 0 10"/><site name="rail" pos="0.3 0 0" euler="0 60 10"/>
      <body pos="0.2 0.1 0"><joint type="ball"/><geom type="capsule" size="0.1 0.2"/>
        <site name="elbow" pos="0.1 0 0.2" euler="0 20 70"/>
        <body pos="0 0 0.4"><joint axis="1 2 0" armature="0.1"/><geom type="capsule" size="0.05 0.2"/>
          <site name="tip" pos="0 0.1 0.3" euler="20 0 50"/></body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor site="tip" gear="1 2 3 0.4 0.5 0.6"/> <velocity site="elbow" gear="1 0 2 0 0.5 0" kv="0.3"/>
    <position site="tip" refsite="back" gear="1 -2 0.5 0 0 0" kp="4" kv="0.2"/>
    <position site="tip" refsite="still" gear="0 0 0 0.5 -0.3 0.2" kp="2"/>
    <general site="elbow" refsite="tip" gear="1 0.5 0 0.2 0 0.1" gaintype="affine" gainprm="1 2 -0.5"/>
    <position cranksite="tip" slidersite="rail" cranklength="2" gear="0.7" kp="3" kv="0.5"/>
    <position cranksite="elbow" slidersite="rail" cranklength="0.2" gear="1.5" kp="3"/>
  </actuator>
</mujoco>
"""


@pytest.mark.parametrize("option", ["", 'integrator="implicitfast"'])
def test_actuators_on_sites_are_mujoco_s(option: str) -> None:
    model = mujoco.MjModel.from_xml_string(SITES.format(option=option))
    assert uncovered(model) is None
    datas = random_states(model, 0.5)
    ours, state, ctrl = read_model(model), state_of(datas), of_all(datas, "ctrl")
    assert_forces_are_mujoco_s(model, datas)
    moved = control_step(ours, 10, state, ctrl)
    for _ in range(9):
        for data in datas:
            mujoco.mj_step(model, data)
    for field in ("qpos", "qvel"):
        assert_close(getattr(moved, field), of_all(datas, field), 1e-9)


@pytest.mark.parametrize("option", ["", 'integrator="implicitfast"'])
def test_springs_and_dampers_that_are_not_linear_are_mujoco_s(option: str) -> None:
    bent = PULLED.format(option=option, flag="")
    for mine, other in (
        ('type="free" stiffness="3"', 'type="free" stiffness="3 1 0.5" damping="0 0.2 0.1"'),
        ('stiffness="5" damping="0.3"', 'stiffness="5 -1 2" damping="0.3 0.2"'),
        ('stiffness="2" damping="0.1"', 'stiffness="2 1 0.5" damping="0.1 0.2 0.3"'),
        ('stiffness="2" damping="0.3" armature', 'stiffness="2 0.3 0.1" damping="0.3 0.2 0.1" armature'),
    ):
        assert mine in bent
        bent = bent.replace(mine, other)
    model = mujoco.MjModel.from_xml_string(bent)
    assert uncovered(model) is None
    datas = random_states(model, 0.5)
    ours, state, ctrl = read_model(model), state_of(datas), of_all(datas, "ctrl")
    assert_forces_are_mujoco_s(model, datas)
    assert_close(substep(ours, state, ctrl).qvel, of_all(datas, "qvel"))


def test_both_ends_of_a_narrow_range_are_mujoco_s_rows() -> None:
    narrow = PULLED.format(option="", flag="")
    for name, mine in (("range", '<fixed name="across"'), ("range", '<joint name="hip"')):
        narrow = narrow.replace(mine, f'{mine} limited="true" {name}="-0.3 0.3" margin="1"')
    model = mujoco.MjModel.from_xml_string(narrow)
    assert uncovered(model) is None
    datas = random_states(model, 0.3)
    assert max(data.nefc for data in datas) == 4
    assert_same_rows(model, datas)


def test_a_mocap_body_stands_still_and_is_leant_on() -> None:
    model = mujoco.MjModel.from_xml_string("""
      <mujoco><worldbody><geom type="plane" size="5 5 1"/>
        <body name="tray" mocap="true" pos="0 0 0.1" euler="3 0 0"><geom type="capsule" size="0.1 0.5"/>
          <body pos="0.2 0 0.1"><geom type="box" size="0.2 0.2 0.1"/></body></body>
        <body pos="0 0.05 0.4"><freejoint/><geom size="0.1"/></body>
        <body pos="0.2 0 0.4"><freejoint/><geom size="0.1"/></body>
      </worldbody></mujoco>
    """)
    assert uncovered(model) is None
    assert uncovered_own(model, ("body_pos",)) == "body_pos: its body 'tray' is a mocap body"
    model = converge(model, implicit_damping=True)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 60)
    assert data.ncon > 0
    ours = read_model(model)
    state = recorded(replace(ours, solver=replace(ours.solver, **THOROUGH)), state_of([data]), [])
    after = state(state_of([data]), [])
    mujoco.mj_step(model, data)
    for field in ("qpos", "qvel"):
        assert_close(getattr(after, field), of_all([data], field), 1e-9)


def test_a_rotation_s_vector_is_mujoco_s() -> None:
    quaternions = np.random.default_rng(0).normal(size=(1000, 4))
    quaternions[:8] = [*np.eye(4), *-np.eye(4)]
    quaternions[8:16, 1:] *= 1e-9
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    theirs = np.zeros((1000, 3))
    for quaternion, vector in zip(quaternions, theirs, strict=True):
        mujoco.mju_quat2Vel(vector, quaternion, 1.0)
    np.testing.assert_allclose(np.stack(rotation_vector(list(quaternions.T)), 1), theirs, rtol=0, atol=1e-13)
