"""Free bodies that carry no joints, under `implicitfast`."""

from mujoco_compiled.tests.test_random_models import compare

BODIES = """
<mujoco>
  <option integrator="implicitfast" timestep="0.01" impratio="2"/>
  <worldbody>
    <geom type="plane" size="5 5 1"/>
    <body pos="0 0 0.2"><joint type="free" damping="3" armature="0.1"/>
      <geom type="box" size="0.1 0.2 0.3" pos="0.1 0.05 0" euler="10 20 30"/>
      <body pos="0.3 0 0" euler="3 4 5"><geom size="0.1 0.05" type="capsule" contype="0"/></body></body>
    <body pos="1 0 0.3"><freejoint name="ball"/><geom size="0.1"/></body>
    <body pos="2 0 1"><joint type="ball" damping="0.1"/>
      <geom type="box" size="0.1 0.2 0.1" pos="0.1 0 0.1"/></body>
  </worldbody>
  <actuator><velocity joint="ball" gear="1 2 0 0 3 1" kv="0.5"/></actuator>
</mujoco>
"""


def test_a_free_body_that_carries_no_joints_moves_as_in_mujoco() -> None:
    seen = compare(BODIES)
    assert seen["states"] == 8
    assert seen["states with contacts"] > 2
