"""Derived fields are those that C MuJoCo computes for the state."""

import mujoco
import numpy as np
import pytest

from mujoco_compiled.coverage import uncovered_fields
from mujoco_compiled.fields import Fields
from mujoco_compiled.readings.derived import DERIVED_FIELDS, derived
from mujoco_compiled.readings.scene import Scene
from mujoco_compiled.tests.bodies import brax_model

NUM_STATES = 8
OF_A_STATE = tuple(name for name in DERIVED_FIELDS if name != "qfrc_actuator")
SENSING = """
<mujoco>
  <option magnetic="1 2 3"/>
  <worldbody>
    <site name="lamp" pos="1 2 3" euler="20 30 40"/>
    <body name="trunk" pos="0 0 1">
      <freejoint name="root"/>
      <geom name="box" type="box" size="0.1 0.2 0.3" pos="0.1 0 0.2" euler="10 20 30"/>
      <site name="back" pos="0.1 0.2 0.3" euler="50 0 10"/>
      <body name="arm" pos="0.2 0.1 0" euler="30 0 60">
        <joint name="shoulder" type="ball" pos="0 0.1 0.05"/>
        <geom type="ellipsoid" size="0.1 0.05 0.2" pos="0 0 0.1"/>
        <body name="hand" pos="0 0 0.4">
          <joint name="wrist" axis="1 2 0" pos="0.1 0 0" ref="20"/>
          <joint name="reach" type="slide" axis="0 1 1"/>
          <geom name="palm" type="capsule" size="0.05 0.2" mass="0.7"/>
          <geom name="palm ball" size="0.1" pos="0.2 0 0.3"/><site name="tip" pos="0 0 0.3"/>
        </body>
      </body>
    </body>
  </worldbody>
  <tendon>
    <fixed name="both"><joint joint="wrist" coef="0.5"/><joint joint="reach" coef="-2"/></fixed>
    <spatial name="string">
      <site site="lamp"/><geom geom="palm ball"/><site site="tip"/><site site="back"/></spatial>
  </tendon>
  <actuator><motor name="pull" tendon="both" gear="3"/><motor name="turn" joint="wrist" gear="2"/>
    <motor name="string" tendon="string" gear="-3"/></actuator>
  <sensor>
    <jointpos joint="wrist"/> <jointvel joint="reach" cutoff="0.3"/> <ballquat joint="shoulder"/>
    <ballangvel joint="shoulder"/> <tendonpos tendon="both"/> <tendonvel tendon="both"/>
    <actuatorpos actuator="pull"/> <actuatorvel actuator="pull"/> <actuatorpos actuator="turn"/>
    <tendonpos tendon="string"/> <tendonvel tendon="string"/>
    <actuatorpos actuator="string"/> <actuatorvel actuator="string"/>
    <framepos objtype="xbody" objname="hand"/>
    <framepos objtype="geom" objname="palm" reftype="body" refname="trunk"/>
    <framequat objtype="site" objname="back"/>
    <framequat objtype="body" objname="arm" reftype="site" refname="back"/>
    <framexaxis objtype="geom" objname="box"/>
    <framezaxis objtype="site" objname="tip" reftype="xbody" refname="arm"/>
    <framelinvel objtype="site" objname="tip"/>
    <framelinvel objtype="body" objname="hand" reftype="site" refname="back"/>
    <frameangvel objtype="geom" objname="box"/>
    <frameangvel objtype="xbody" objname="hand" reftype="geom" refname="box"/>
    <framelinvel objtype="site" objname="lamp" reftype="site" refname="back"/>
    <gyro site="back"/> <velocimeter site="tip"/> <magnetometer site="tip"/>
    <subtreecom body="arm"/> <subtreelinvel body="trunk"/> <clock/>
  </sensor>
</mujoco>
"""


@pytest.mark.parametrize("name", ["humanoid", "reacher", "sensing"])
def test_derived_fields_are_mujoco_s(name: str) -> None:
    model = mujoco.MjModel.from_xml_string(SENSING) if name == "sensing" else brax_model(name)
    generator = np.random.default_rng(0)
    datas = [mujoco.MjData(model) for _ in range(NUM_STATES)]
    for data in datas:
        data.time = generator.uniform()
        data.qpos[:] += generator.normal(size=model.nq)
        data.qvel[:] = generator.normal(size=model.nv)
        mujoco.mj_forward(model, data)
    qpos, qvel = (list(np.stack([getattr(data, field) for data in datas], 1)) for field in ("qpos", "qvel"))
    scene = Scene(Fields(model), qpos, qvel, np.array([data.time for data in datas]))
    assert uncovered_fields(model, DERIVED_FIELDS) is None
    for field, numbers in derived(scene, OF_A_STATE).items():
        theirs = np.stack([np.ravel(getattr(data, field)) for data in datas], 1)
        assert len(numbers) == len(theirs)
        for mine, other in zip(numbers, theirs, strict=True):
            np.testing.assert_allclose(np.broadcast_to(mine, NUM_STATES), other, rtol=1e-12, atol=1e-12)


def test_sensors_of_what_is_not_computed_are_named() -> None:
    xml = SENSING.replace("<clock/>", '<force name="bump" site="tip"/>')
    model = mujoco.MjModel.from_xml_string(xml)
    assert uncovered_fields(model, ("xpos",)) is None
    assert "'bump'" in (uncovered_fields(model, ("sensordata",)) or "")
