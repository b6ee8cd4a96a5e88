"""Equalities, which close loops and couple joints, against C MuJoCo."""

from copy import copy
from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from mujoco_compiled import make_data, put_model, step
from mujoco_compiled.coverage import uncovered
from mujoco_compiled.tests.extra import extra
from mujoco_compiled.tests.rows_of_mujoco import assert_same_rows, rows_of
from mujoco_compiled.tests.test_fold import assert_moves_alike, plan_of
from mujoco_compiled.tests.test_random_models import compare
from mujoco_compiled.write import control_step_in_lanes

TIED = """
<mujoco>
  <option><flag equality="{flag}"/></option>
  <worldbody>
    <body name="trunk" pos="0 0 1"><freejoint/><geom size="0.1" mass="3" contype="0"/>
      <body name="a" pos="0.2 0 0"><joint name="a" axis="0 1 0.3"/>
        <geom type="capsule" size="0.03" fromto="0 0 0 0.3 0.1 0" contype="0"/>
        <site name="a" pos="0.3 0.1 0" euler="10 20 30"/></body>
      <body name="b" pos="0 0.2 0"><joint name="b" axis="1 0 0.3" ref="20"/>
        <geom type="capsule" size="0.03" fromto="0 0 0 0.3 0.1 0" contype="0"/>
        <site name="b" pos="0.3 0.1 0.1" euler="40 20 30"/></body>
    </body>
    <body name="sled"><joint name="sled" type="slide" axis="1 2 3"/><geom size="0.1" contype="0"/></body>
    <body name="box"><freejoint/><geom size="0.2" contype="0"/></body>
  </worldbody>
  <tendon>
    <fixed name="sum"><joint joint="a" coef="2"/><joint joint="b" coef="-1"/></fixed>
    <fixed name="one"><joint joint="a" coef="0.5"/></fixed>
  </tendon>
  <equality>{equality}</equality>
</mujoco>
"""
SOFT = 'solref="-300 -20" solimp="0.2 0.9 0.5 0.4 3"'
POLYNOMIAL = 'polycoef="0.1 0.2 0.3 0.4 0.5"'


def tied(equality: str, flag: str = "enable") -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(TIED.format(equality=equality, flag=flag))


def pulled_apart(model: mujoco.MjModel, num_states: int = 8) -> list[mujoco.MjData]:
    """States in which nothing is where equalities would have it."""
    generator, found = np.random.default_rng(0), list[mujoco.MjData]()
    for _ in range(num_states):
        data = mujoco.MjData(model)
        mujoco.mj_integratePos(model, data.qpos, generator.normal(size=model.nv), 0.5)
        data.qvel[:] = generator.normal(size=model.nv)
        mujoco.mj_forward(model, data)
        found.append(data)
    return found


@pytest.mark.parametrize(
    "equality",
    [
        '<connect body1="a" body2="b" anchor="0.1 0 0"/>',
        '<connect body1="a" body2="box" anchor="0.1 0 0.3"/>',
        '<connect body1="a" anchor="0.1 0 0.2"/>',
        f'<connect site1="a" site2="b" {SOFT}/>',
        '<weld body1="trunk" body2="b"/>',
        '<weld body1="box" body2="a" torquescale="3" anchor="0.1 0.2 0.3" relpose="1 2 3 1 1 0 0"/>',
        '<weld body1="sled"/>',
        f'<weld site1="a" site2="b" torquescale="0.5" {SOFT}/>',
        f'<joint joint1="a" joint2="b" {POLYNOMIAL}/>',
        f'<joint joint1="b" {POLYNOMIAL} {SOFT}/>',
        f'<tendon tendon1="sum" tendon2="one" {POLYNOMIAL}/>',
        '<tendon tendon1="sum"/>',
    ],
)
def test_an_equality_has_mujoco_s_rows(equality: str) -> None:
    model = tied(equality)
    assert uncovered(model) is None
    assert_same_rows(model, pulled_apart(model))


def test_equalities_that_are_not_active_are_left_out() -> None:
    both = '<weld body1="box" active="{}"/><joint joint1="a" active="{}"/>'
    assert num_rows(tied(both.format("false", "true"))) == 1
    assert num_rows(tied(both.format("true", "false"))) == 6
    assert num_rows(tied(both.format("true", "true"), "disable")) == 0


def num_rows(model: mujoco.MjModel) -> int:
    return sum(group.size for group in rows_of(model, pulled_apart(model, 1)).groups)


@pytest.mark.parametrize(
    ("equality", "named"),
    [
        (
            '<joint name="knee" joint1="a" solimp="0.9 0.95 0.1 0.5 2.2"/>',
            "its equality 'knee' has a `solimp`",
        ),
        ('<joint name="knee" joint1="a" solimp="0.9 0.95 0.1 0.5 2.2" active="false"/>', None),
        ('<connect name="pin" body1="box" anchor="0.1 0 0"/>', None),
    ],
)
def test_equalities_that_are_not_covered_are_named(equality: str, named: str | None) -> None:
    reason = uncovered(tied(equality))
    assert reason is None if named is None else named in (reason or "")


@pytest.mark.parametrize(("offset", "is_refused"), [(0.0, True), (0.001, True), (0.05, False)])
def test_ties_of_a_body_that_turns_about_its_centre_are_named(offset: float, *, is_refused: bool) -> None:
    # As with contacts: MuJoCo's inverse weight is 0 where the hinge goes through the centre.
    geom = f'<geom type="box" size="0.3 0.1 0.1" pos="0 0 {offset}"/>'
    crank = f'<body name="crank"><joint axis="0 1 0"/>{geom}</body>'
    tie = '<equality><connect name="pin" body1="crank" anchor="0.3 0 0"/></equality>'
    reason = uncovered(
        mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{crank}</worldbody>{tie}</mujoco>")
    )
    assert ("'pin' ties bodies that turn about their centres" in (reason or "")) == is_refused


def leg(side: str, y: float) -> str:
    """As Cassie's: a shin, and a rod from the hip to it, which the model's tree leaves open."""
    return f"""
      <body name="{side} thigh" pos="0 {y} 0"><joint name="{side} hip" axis="0 1 0" range="-60 60"/>
        <geom type="capsule" size="0.03" fromto="0 0 0 0.05 0 -0.3"/>
        <body name="{side} shin" pos="0.05 0 -0.3"><joint name="{side} knee" axis="0 1 0" armature="0.01"/>
          <geom type="capsule" size="0.025" fromto="0 0 0 -0.1 0 -0.3"/>
          <geom type="sphere" size="0.04" pos="-0.1 0 -0.3" contype="1" condim="3"/></body>
        <body name="{side} rod" pos="-0.1 0 0"><joint axis="0 1 0"/><joint axis="1 0 0" stiffness="1"/>
          <geom type="capsule" size="0.01" fromto="0 0 0 0.07 0 -0.37"/></body>
      </body>"""


def legged(more: str = "") -> str:
    names, y = ("left", "right"), 0.1
    legs = "".join(leg(side, sign * y) for side, sign in zip(names, (1, -1), strict=True))
    ties = "".join(
        f'<connect body1="{side} rod" body2="{side} shin" anchor="0.07 0 -0.37"/>' for side in names
    )
    motors = "".join(f'<position joint="{side} hip" kp="40" kv="1"/>' for side in names)
    return f"""
    <mujoco>
      <compiler autolimits="true"/>
      <default><geom contype="0" conaffinity="0"/><joint damping="0.1"/></default>
      <worldbody>
        <geom type="plane" size="5 5 1" conaffinity="1" contype="1"/>
        <body name="trunk" pos="0 0 0.66"><freejoint/><geom type="box" size="0.1 0.15 0.08"/>{legs}</body>
      </worldbody>
      <equality>{ties}{more}</equality>
      <actuator>{motors}</actuator>
    </mujoco>"""


GRIPPER = """
<mujoco>
  <option integrator="implicitfast"/>
  <worldbody>
    <body pos="0 0 0.5"><joint name="wrist" axis="1 0 0.2" damping="0.1"/>
      <geom type="box" size="0.05 0.05 0.03" pos="0 0.02 0.01"/>
      <body name="left" pos="0 0.05 0.06">
        <joint name="left" type="slide" axis="0 1 0" range="-0.04 0.04" limited="true"/>
        <geom type="box" size="0.01 0.01 0.04"/></body>
      <body name="right" pos="0 -0.05 0.06">
        <joint name="right" type="slide" axis="0 -1 0" frictionloss="0.1"/>
        <geom type="box" size="0.01 0.01 0.04"/></body>
    </body>
  </worldbody>
  <equality>
    <joint joint1="left" joint2="right" polycoef="0 1 0.5" solimp="0.95 0.99 0.001" solref="0.005 1"/>
  </equality>
  <actuator><position joint="left" kp="200" kv="5"/><motor joint="wrist"/></actuator>
</mujoco>
"""
IN_HAND = """
<mujoco>
  <option cone="elliptic"/>
  <worldbody>
    <geom type="plane" size="5 5 1"/>
    <body pos="0 0 0.4"><joint name="shoulder" axis="0 1 0" damping="0.1"/>
      <geom type="capsule" size="0.03" fromto="0 0 0 0.3 0 0" contype="0"/>
      <body pos="0.3 0 0"><joint name="elbow" axis="0 1 0.1" damping="0.1"/>
        <geom type="capsule" size="0.03" fromto="0 0 0 0.3 0 0" contype="0"/>
        <site name="hand" pos="0.33 0 0" euler="0 90 0"/></body>
    </body>
    <body name="box" pos="0.7 0 0.4"><freejoint/><geom type="box" size="0.05 0.06 0.07"/>
      <site name="handle" pos="-0.07 0 0" euler="0 90 0"/></body>
  </worldbody>
  <equality><weld site1="hand" site2="handle" torquescale="0.1"/></equality>
  <actuator><motor joint="shoulder" gear="5"/><motor joint="elbow" gear="5"/></actuator>
</mujoco>
"""
DIFFERENTIAL = """
<mujoco>
  <default><geom contype="0" conaffinity="0"/></default>
  <worldbody>
    <body><joint name="left" axis="0 1 0" armature="0.01"/><geom size="0.05" pos="0.01 0 0"/></body>
    <body pos="0 0.3 0"><joint name="right" axis="0 1 0" armature="0.02"/><geom size="0.05"/></body>
    <body pos="0 0.1 0"><joint name="cage" axis="0 1 0" damping="0.01"/>
      <geom type="box" size="0.1 0.05 0.02"/></body>
  </worldbody>
  <tendon>
    <fixed name="wheels"><joint joint="left" coef="0.5"/><joint joint="right" coef="0.5"/></fixed>
    <fixed name="cage"><joint joint="cage" coef="1"/></fixed>
  </tendon>
  <equality><tendon tendon1="wheels" tendon2="cage"/></equality>
  <actuator><motor joint="cage"/></actuator>
</mujoco>
"""
# Of all their geoms, so that contacts are in slots.
TOUCHING = (
    legged().replace('<geom contype="0" conaffinity="0"/>', "").replace("0.1 0.15 0.08", "0.05 0.15 0.08")
)
BODIES = {
    "legs": legged(),
    "legs that touch": TOUCHING,
    "gripper": GRIPPER,
    "in hand": IN_HAND,
    "differential": DIFFERENTIAL,
}


@pytest.mark.parametrize("name", ["legs", *extra("gripper", "in hand", "differential")])
def test_a_tied_body_moves_as_in_mujoco(name: str) -> None:
    assert compare(BODIES[name])["states"]


@pytest.mark.parametrize("name", ["in hand", *extra("legs", "legs that touch", "gripper", "differential")])
def test_machine_code_moves_a_tied_body_as_mujoco_does(name: str) -> None:
    model = mujoco.MjModel.from_xml_string(BODIES[name])
    assert uncovered(model) is None
    m, generator = put_model(model, nstep=10), np.random.default_rng(0)
    qvel, ctrl = (0.1 * generator.normal(size=(4, size)) for size in (model.nv, model.nu))
    begun = jax.vmap(lambda qvel, ctrl: make_data(m).replace(qvel=qvel, ctrl=ctrl))
    state, moved = begun(jnp.asarray(qvel), jnp.asarray(ctrl)), jax.jit(jax.vmap(partial(step, m)))
    for _ in range(5):
        state = moved(state)
    for place in range(4):
        data = mujoco.MjData(model)
        data.qvel[:], data.ctrl[:] = qvel[place], ctrl[place]
        mujoco.mj_step(model, data, 50)
        np.testing.assert_allclose(state.qpos[place], data.qpos, rtol=0, atol=1e-4)
        np.testing.assert_allclose(state.qvel[place], data.qvel, rtol=0, atol=3e-3)


@pytest.mark.parametrize(
    ("more", "num_lanes"),
    [
        ("", 2),
        ('<connect body1="left shin" body2="right shin" anchor="0 -0.1 0"/>', 1),
        ('<joint joint1="left hip" joint2="right hip"/>', 1),
        ('<weld body1="left rod" body2="trunk"/>', 1),
    ],
)
def test_limbs_share_a_program_unless_an_equality_tells_them_apart(more: str, num_lanes: int) -> None:
    plan = plan_of(mujoco.MjModel.from_xml_string(legged(more)))
    lanes = control_step_in_lanes(plan, 2)
    assert lanes.num_lanes == num_lanes
    assert_moves_alike(plan, lanes)


def test_environments_with_bodies_of_their_own_have_mujoco_s_rows() -> None:
    model, generator = (
        tied('<weld body1="box" body2="a"/><joint joint1="a" joint2="b"/>'),
        np.random.default_rng(0),
    )
    datas = pulled_apart(model)
    models = [copy(model) for _ in datas]
    names = ("body_pos", "body_quat", "body_ipos", "body_invweight0", "dof_invweight0")
    for one, data in zip(models, datas, strict=True):
        for name in names:
            values = getattr(one, name)
            values *= generator.uniform(0.8, 1.2, size=values.shape)
        one.body_quat[:] /= np.linalg.norm(one.body_quat, axis=1, keepdims=True)
        mujoco.mj_forward(one, data)
    assert_same_rows(model, datas, {name: own_of(models, name) for name in names})


def own_of(models: list[mujoco.MjModel], name: str) -> list[np.ndarray]:
    return list(np.stack([np.ravel(getattr(one, name)) for one in models], axis=1))
