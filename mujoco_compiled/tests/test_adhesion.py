"""Actuators that make bodies stick, beside C MuJoCo's."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from mujoco_compiled.coverage import uncovered, uncovered_fields
from mujoco_compiled.substep import SubstepState, read_model
from mujoco_compiled.tests.extra import extra
from mujoco_compiled.tests.recorded_substep import recorded
from mujoco_compiled.tests.states import THOROUGH, converge, of_all, relative
from mujoco_compiled.tests.test_contact_substep import falling, step_converged

# Two blocks that stick to each other and to the floor: some points are counted before they push.
BLOCKS = """
<mujoco>
  <option timestep="0.002" cone="{cone}" {option}/>
  <default><geom friction="0.8" condim="{condim}"/></default>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 1" margin="0.02" gap="0.015"/>
    <body name="lower" pos="0 0 0.2"><freejoint/><geom size="0.1" margin="0.01" gap="0.01"/>
      <geom type="capsule" size="0.05" fromto="0.1 -0.1 0 0.1 0.1 0"/>
      <body name="upper" pos="0 0 0.2"><joint name="x" type="slide" axis="1 0 0" damping="1"/>
        <joint name="z" type="slide" axis="0 0 1" damping="1"/>
        <geom size="0.06" pos="0 0 -0.02" mass="0.3"/></body>
    </body>
    <body name="ball" pos="0.3 0 0.1"><freejoint/><geom size="0.08"/></body>
  </worldbody>
  <actuator>
    <adhesion name="suction" body="lower" gain="40" ctrlrange="0 1"/>
    <adhesion body="ball" gain="15" ctrlrange="0 1"/>
    <general body="ball" gear="-2" gainprm="3" biastype="affine" biasprm="0.5 0 -0.2" dyntype="filter"
      dynprm="0.02"/>
    <motor joint="x" gear="3" ctrlrange="-1 1"/>
  </actuator>
  {sensor}
</mujoco>
"""


def blocks(cone: str = "elliptic", condim: int = 3, option: str = "", sensor: str = "") -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(
        BLOCKS.format(cone=cone, condim=condim, option=option, sensor=sensor)
    )


@pytest.mark.parametrize(
    ("cone", "condim", "option"),
    [
        ("pyramidal", 3, 'integrator="implicitfast"'),
        *extra(("elliptic", 4, ""), ("elliptic", 1, ""), ("pyramidal", 6, "")),
    ],
)
def test_what_sticks_moves_as_in_mujoco(cone: str, condim: int, option: str) -> None:
    model = converge(blocks(cone, condim, option), implicit_damping=True)
    assert uncovered(model) is None
    datas = falling(model)
    assert max(np.abs(data.actuator_moment[:4]).max() for data in datas) > 0.1
    assert any(contact.exclude == 1 for data in datas for contact in data.contact)
    ours = read_model(model)
    ours = replace(ours, solver=replace(ours.solver, **THOROUGH))
    names = ("qpos", "qvel", "act", "qacc_warmstart")
    state, ctrl = SubstepState(*(of_all(datas, name) for name in names)), of_all(datas, "ctrl")
    step = recorded(ours, state, ctrl)
    for number in range(5):
        state = step(state, ctrl)
        for data in datas:
            step_converged(model, data)
        if number == 0:
            assert relative(state.qacc, of_all(datas, "qacc")) < 1e-9
    assert relative(state.qvel, of_all(datas, "qvel")) < 1e-6


def test_a_body_that_nothing_can_touch_is_not_pulled() -> None:
    model = blocks()
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    datas = falling(model)[:1]
    names = ("qpos", "qvel", "act", "qacc_warmstart")
    state, ctrl = SubstepState(*(of_all(datas, name) for name in names)), of_all(datas, "ctrl")
    after = recorded(read_model(model), state, ctrl)(state, ctrl)
    mujoco.mj_step(model, datas[0])
    np.testing.assert_allclose(np.ravel(after.qvel), datas[0].qvel, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("kind", ["actuatorpos", "actuatorvel"])
def test_sensors_of_what_sticks_are_named(kind: str) -> None:
    model = blocks(sensor=f'<sensor><{kind} name="seen" actuator="suction"/></sensor>')
    reason = "sensordata: its sensor 'seen' is the length or the rate of an actuator on a body"
    assert uncovered_fields(model, ("sensordata",)) == reason
