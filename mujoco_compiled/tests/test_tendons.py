"""Spatial tendons against C MuJoCo: their lengths and moment arms, and how they move bodies."""

from collections.abc import Iterator
from dataclasses import replace
from random import Random

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from mujoco_compiled.coverage import uncovered, uncovered_own
from mujoco_compiled.program.arithmetic import Vector
from mujoco_compiled.smooth.dynamics import motion
from mujoco_compiled.smooth.kinematics import poses
from mujoco_compiled.smooth.paths import Posture
from mujoco_compiled.smooth.tendons import read_tendons, with_tendons
from mujoco_compiled.smooth.tree import read_tree
from mujoco_compiled.substep import read_model
from mujoco_compiled.tests.random_models import random_strings
from mujoco_compiled.tests.recorded_substep import recorded
from mujoco_compiled.tests.states import THOROUGH, converge
from mujoco_compiled.tests.test_forces import assert_close, of_all, random_states, state_of
from mujoco_compiled.write import Plan, control_step_in_lanes

NUM_STATES = 100
# How far MuJoCo's own iterations for strings through rings are from where they lead, in moment arms in m.
RINGS = 1e-4
LIMIT = mujoco.mjtConstraint.mjCNSTR_LIMIT_TENDON
STRINGS = """
<mujoco>
  <option timestep="0.002" {option}/>
  <default><geom contype="0" conaffinity="0"/></default>
  <worldbody>
    <site name="wall" pos="0 0.3 0.4"/><geom name="knob" size="0.1" pos="0.2 0.1 0.3"/>
    <body name="trunk"><freejoint/>
      <geom name="ball" size="0.12" pos="0.1 0.05 0.5"/>
      <geom name="roll" type="cylinder" size="0.1 0.2" pos="0 0.02 0.45" euler="20 40 60"/>
      <site name="a" pos="0.2 0.1 0.3"/><site name="b" pos="-0.2 0.3 0.1"/>
      <site name="by the ball" pos="0.3 0.05 0.5"/><site name="in the ball" pos="0.15 0.05 0.5"/>
      <site name="by the roll" pos="0.1 0.3 0.5"/><site name="in the roll" pos="0.03 0.02 0.48"/>
      <body pos="0 0 0.5"><joint type="ball" damping="0.1"/><geom type="capsule" size="0.05 0.2"/>
        <site name="c" pos="0.2 0 0.2"/><site name="d" pos="0 0.3 0.3"/>
        <body pos="0 0 0.4"><joint axis="0 1 1" armature="0.01"/><geom type="capsule" size="0.05 0.1"/>
          <site name="e" pos="0.1 0.1 0.2"/></body>
      </body>
    </body>
  </worldbody>
  <tendon>
    <spatial name="straight" stiffness="20" damping="1" springlength="0.5 0.9" armature="0.3">
      <site site="wall"/><site site="a"/><site site="b"/><site site="c"/><site site="e"/></spatial>
    <spatial name="pulley" range="0.2 0.8" solreflimit="0.01 1" armature="0.7">
      <site site="a"/><site site="c"/><pulley divisor="2"/><site site="b"/><site site="d"/>
      <pulley divisor="3"/><site site="wall"/><site site="e"/></spatial>
    <spatial name="round" frictionloss="0.5"><site site="a"/><geom geom="ball"/><site site="c"/></spatial>
    <spatial name="beside" stiffness="5">
      <site site="a"/><geom geom="ball" sidesite="by the ball"/><site site="c"/></spatial>
    <spatial name="rolling" damping="2"><site site="a"/><geom geom="roll"/><site site="c"/></spatial>
    <spatial name="beside a roll">
      <site site="a"/><geom geom="roll" sidesite="by the roll"/><site site="c"/></spatial>
    <spatial name="two"><site site="a"/><geom geom="roll"/><site site="d"/><geom geom="knob"/><site site="e"/>
    </spatial>
    {more}
  </tendon>
  <equality><tendon tendon1="two" tendon2="straight" polycoef="0.1 0.3 -0.2 0 0" solref="0.1 1"/></equality>
  <actuator>
    <position tendon="straight" kp="20" kv="1" ctrlrange="-1 1" forcerange="-9 9"/>
    <motor tendon="two" gear="-2"/> <velocity tendon="beside a roll" kv="2"/>
    <general tendon="rolling" dyntype="filter" dynprm="0.05" gaintype="affine" gainprm="1 2 -0.5"/>
  </actuator>
</mujoco>
"""
ROUND = '<spatial><site site="a"/><geom geom="{}" sidesite="{}"/><site site="c"/></spatial>'


def strings(option: str = "", more: str = "") -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(STRINGS.format(option=option, more=more))


def moment_arms(model: mujoco.MjModel, data: mujoco.MjData) -> NDArray[np.float64]:
    """MuJoCo's `ten_J` [ntendon, nv]."""
    found = np.zeros((model.ntendon, model.nv))
    structure = model.ten_J_rownnz, model.ten_J_rowadr, model.ten_J_colind
    mujoco.mju_sparse2dense(found, data.ten_J, *structure)
    return found


def errors(model: mujoco.MjModel, num_states: int = NUM_STATES) -> Iterator[tuple[float, float, int]]:
    """By tendon: the largest errors of its length and moment arms in random states, and in how many of these
    it wraps round something."""
    generator, datas = np.random.default_rng(0), list[mujoco.MjData]()
    for _ in range(num_states):
        datas.append(mujoco.MjData(model))
        mujoco.mj_integratePos(model, datas[-1].qpos, generator.normal(size=model.nv), 0.8)
        mujoco.mj_forward(model, datas[-1])
    qpos: Vector = of_all(datas, "qpos")
    tree = read_tree(model)
    at = poses(tree, qpos)
    moving = motion(tree, at, of_all(datas, "qvel"))
    theirs = np.stack([moment_arms(model, data) for data in datas])
    posture = with_tendons(Posture(tree, at, moving, qpos), read_tendons(model))
    for number, ours in enumerate(posture.tendons):
        lengths = np.array([data.ten_length[number] for data in datas])
        arms = [ours.moment.get(dof, 0.0) - theirs[:, number, dof] for dof in range(model.nv)]
        straight = np.min([data.ten_wrapnum[number] for data in datas])
        num_round = sum(data.ten_wrapnum[number] > straight for data in datas)
        yield float(np.abs(ours.length - lengths).max()), max(float(np.abs(x).max()) for x in arms), num_round


def test_lengths_and_moment_arms_are_mujoco_s() -> None:
    found = list(errors(strings()))
    assert max(max(apart, arm) for apart, arm, _ in found) < 1e-12
    for _, _, num_round in found[2:]:
        assert 10 < num_round < NUM_STATES - 10


def test_a_string_through_a_ring_is_mujoco_s() -> None:
    more = ROUND.format("ball", "in the ball") + ROUND.format("roll", "in the roll")
    for apart, arm, num_round in list(errors(strings(more=more)))[-2:]:
        assert apart < 1e-9
        assert arm < RINGS
        assert 10 < num_round < NUM_STATES - 10


@pytest.mark.extra
@pytest.mark.parametrize("seed", range(30))
def test_random_strings_are_mujoco_s(seed: int) -> None:
    apart, arm, _ = np.max(list(errors(mujoco.MjModel.from_xml_string(random_strings(Random(seed))))), axis=0)
    assert apart < 1e-9
    assert arm < RINGS


@pytest.mark.parametrize("option", ["", 'integrator="implicitfast"'])
def test_a_body_pulled_by_strings_moves_as_in_mujoco(option: str) -> None:
    model = converge(strings(option), implicit_damping=True)
    assert uncovered(model) is None
    datas, ours = random_states(model, 0.5), read_model(model)
    state, ctrl = state_of(datas), of_all(datas, "ctrl")
    step = recorded(replace(ours, solver=replace(ours.solver, **THOROUGH)), state, ctrl)
    limited = 0
    for _ in range(10):
        state = step(state, ctrl)
        for data in datas:
            mujoco.mj_step(model, data)
        limited += sum(int(np.sum(data.efc_type == LIMIT)) for data in datas)
    for field in ("qpos", "qvel", "act"):
        assert_close(getattr(state, field), of_all(datas, field), 1e-9)
    assert limited > 10


def test_alike_limbs_with_strings_share_a_program() -> None:
    leg = """<body pos="{x} 0 0"><joint axis="0 1 0"/><geom size="0.05" pos="0 0 -0.2"/>
      <geom name="pulley {x}" type="cylinder" size="0.03 0.1" euler="90 0 0"/>
      <site name="hip {x}" pos="0.05 0 0.1"/>
      <body pos="0 0 -0.4"><joint axis="0 1 0"/><geom size="0.04" pos="0 0 -0.1"/>
        <site name="foot {x}" pos="0.02 0 -0.1"/></body>
    </body>"""
    string = """<spatial name="leg {x}" stiffness="3" range="0.1 0.4"><site site="hip {x}"/>
      <geom geom="pulley {x}"/><site site="foot {x}"/></spatial>"""
    legs, tendons, motors = (
        "".join(one.format(x=x) for x in (-0.2, 0.2)) for one in (leg, string, '<motor tendon="leg {x}"/>')
    )
    model = mujoco.MjModel.from_xml_string(f"""
      <mujoco><default><geom contype="0" conaffinity="0"/></default><worldbody>
        <body><freejoint/><geom size="0.1"/>{legs}</body></worldbody>
        <tendon>{tendons}</tendon><actuator>{motors}</actuator></mujoco>
    """)
    assert uncovered(model) is None
    sizes = {"qpos": model.nq, "qvel": model.nv, "qacc_warmstart": model.nv, "ctrl": model.nu}
    assert control_step_in_lanes(Plan(model, sizes, (), ("ten_length",)), 1).num_lanes == 2


def test_what_strings_lack_is_named() -> None:
    elsewhere = strings(more=ROUND.format("ball", "d"))
    assert uncovered(elsewhere) == "its site 'd' is not on the body of the geom that it is a side of"
    # In the model's own pose it passes the ball without touching, from and to the same body.
    loose = ROUND.format("ball", "by the ball").replace("<spatial", '<spatial name="loose" range="0 1"')
    idle = strings(more=loose.replace('site="c"', 'site="b"'))
    assert "'loose' moves nothing in the model's own pose" in (uncovered(idle) or "")
    ring = strings(more=ROUND.format("roll", "in the roll"))
    assert uncovered_own(ring, ("geom_size",)) == "geom_size: a tendon passes through its geom 'roll'"
