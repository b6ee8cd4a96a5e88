"""Environments whose models differ move as C MuJoCo moves each of those models."""

import copy
from typing import Any

import mujoco
import numpy as np
import pytest

from mujoco_compiled import MODEL_FIELDS
from mujoco_compiled.coverage import uncovered, uncovered_own
from mujoco_compiled.fields import GEOMETRY, Fields, model_field
from mujoco_compiled.program.interpret import interpret
from mujoco_compiled.program.program import Program
from mujoco_compiled.readings.derived import derived
from mujoco_compiled.readings.scene import Scene
from mujoco_compiled.substep import SubstepState, read_model, substep
from mujoco_compiled.tests.rows_of_mujoco import assert_same_rows
from mujoco_compiled.tests.test_contacts import BALL, ROD, at_random, meeting
from mujoco_compiled.tests.test_forces import (
    PULLED,
    assert_close,
    of_all,
    random_states,
    state_of,
)

OF_CONSTRAINTS = ("body_invweight0", "dof_frictionloss", "dof_invweight0", "geom_friction", "geom_solref")
UNUSED = ("actuator_acc0", "tendon_invweight0", *OF_CONSTRAINTS, *GEOMETRY)
OWN = tuple(name for name in MODEL_FIELDS if name not in UNUSED)
OF_MASSES = ("cinert", "cvel", "subtree_com", "xpos")
STATE = ("qpos", "qvel", "act", "qacc_warmstart", "ctrl")


def changed(model: mujoco.MjModel, factor: float) -> mujoco.MjModel:
    """The model with other numbers in all these fields, and the constants that follow."""
    generator, other = np.random.default_rng(0), copy.copy(model)
    for name in OWN:
        values: Any = model_field(other, name)
        values[...] += factor * generator.uniform(0.01, 0.1, size=values.shape) * (values != 0.0)
    other.opt.gravity[:2] = factor
    other.body_quat[:] /= np.linalg.norm(other.body_quat, axis=1, keepdims=True)
    bodies = range(other.nbody - 1, 0, -1)
    other.body_subtreemass[:] = other.body_mass
    for body in bodies:
        other.body_subtreemass[other.body_parentid[body]] += other.body_subtreemass[body]
    return other


def test_environments_with_fields_of_their_own_move_as_in_mujoco() -> None:
    xml = PULLED.replace('<velocity joint="shoulder" gear="1 0 -2" kv="0.1"/>', "")
    model = mujoco.MjModel.from_xml_string(xml.format(option='density="100" viscosity="0.1"', flag=""))
    exact = model.actuator_dyntype == mujoco.mjtDyn.mjDYN_FILTEREXACT
    model.actuator_dyntype[exact] = int(mujoco.mjtDyn.mjDYN_FILTER)
    models = [changed(model, factor) for factor in (1.0, 1.5, 2.0, 0.0)] * 2
    datas = random_states(model, 0.3)
    own = {name: list(np.stack([np.ravel(model_field(one, name)) for one in models], 1)) for name in OWN}
    assert uncovered_own(model, OWN) is None
    state, ctrl = state_of(datas), of_all(datas, "ctrl")
    expected = substep(read_model(model, own), state, ctrl)
    seen = derived(Scene(Fields(model, own), state.qpos, state.qvel), OF_MASSES)
    for one, data in zip(models, datas, strict=True):
        mujoco.mj_forward(one, data)
    for field, numbers in seen.items():
        assert_close(numbers, list(np.stack([np.ravel(getattr(data, field)) for data in datas], 1)))
    for one, data in zip(models, datas, strict=True):
        mujoco.mj_step(one, data)
    for field in ("qpos", "qvel", "act", "qfrc_actuator"):
        assert_close(getattr(expected, field), of_all(datas, field), 1e-11)

    program = Program()
    given = {**own, **dict(zip(STATE, (state.qpos, state.qvel, state.act, state.qacc, ctrl), strict=True))}
    symbols = {name: list(program.inputs(name, len(values))) for name, values in given.items()}
    read = read_model(model, {name: symbols[name] for name in own})
    *carried, control = (symbols[name] for name in STATE)
    program.output("qvel", substep(read, SubstepState(*carried), control).qvel)
    assert_close(interpret(program, given)["qvel"], expected.qvel)


@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
def test_environments_with_constraints_of_their_own_have_mujoco_s_rows(cone: str) -> None:
    stairs = "".join(f'<geom type="box" size="0.5 0.5 0.2" pos="{k - 2} 0 {0.05 * k}"/>' for k in range(4))
    model = meeting(stairs, BALL, ROD, f'cone="{cone}" impratio="3"', 'condim="4" friction="0.8 0.2 0.1"')
    model.jnt_limited[[1, 2]], model.jnt_range[[1, 2]] = True, [[0.0, 0.3], [-0.1, 0.1]]
    model.dof_frictionloss[:] = 0.5
    datas, generator = at_random(model), np.random.default_rng(0)
    models = [copy.copy(model) for _ in datas]
    for one, data in zip(models, datas, strict=True):
        for name in OF_CONSTRAINTS:
            values = getattr(one, name)
            values *= generator.uniform(0.3, 3.0, size=values.shape)
        # Of two geoms that disagree on what it means, and one whose numbers disagree.
        one.geom_solref[generator.integers(6)] *= generator.choice([[-5e4, -50.0], [1.0, 1.0], [1.0, -1.0]])
        mujoco.mj_forward(one, data)
    own = {
        name: list(np.stack([np.ravel(getattr(one, name)) for one in models], 1)) for name in OF_CONSTRAINTS
    }
    for name in OF_CONSTRAINTS:
        assert uncovered_own(model, (name,)) is None
    assert_same_rows(model, datas, own)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("actuator_dynprm", "exact filter"),
        ("actuator_biasprm", "turns several axes"),
        ("dof_frictionloss", "power"),
        ("body_pos", "'shelf' stands still and can be touched"),
    ],
)
def test_fields_that_must_be_the_same_are_named(name: str, reason: str) -> None:
    shelf = '<worldbody><body name="shelf"><geom size="1" contype="2" conaffinity="3"/></body>'
    xml = PULLED.format(option="", flag="").replace("<worldbody>", shelf)
    model = mujoco.MjModel.from_xml_string(
        xml.replace("<geom contype", '<joint solimpfriction="0.8 0.9 0.1 0.5 2.2"/><geom contype')
    )
    model.geom_contype[-1] = 1
    assert uncovered(model) is None
    assert reason in (uncovered_own(model, (name,)) or "")


FIXED = """
<mujoco><worldbody>
  <geom name="floor" type="plane" size="5 5 1"/>
  <body name="wall" pos="0 0 1"><body name="shelf" pos="0.1 0.2 0" euler="10 20 30">
    <geom name="board" size="0.1" {board}/>
    <body name="arm" pos="0 0.3 0"><joint axis="0 1 0"/><geom type="capsule" size="0.05 0.1" pos="0.1 0 0"
      contype="0" conaffinity="0"/></body>
  </body></body>
  <body pos="0 0 3"><freejoint/><geom name="ball" size="0.1"/></body>
</worldbody>{more}</mujoco>
"""
UNTOUCHED = 'contype="0" conaffinity="0"'
PAIR = '<contact><pair geom1="board" geom2="ball"/></contact>'


@pytest.mark.parametrize("name", ["body_pos", "body_quat"])
@pytest.mark.parametrize(("board", "more"), [("", ""), (UNTOUCHED, PAIR)])
def test_a_fixed_body_that_can_be_touched_must_be_where_the_model_has_it(
    name: str, board: str, more: str
) -> None:
    model = mujoco.MjModel.from_xml_string(FIXED.format(board=board, more=more))
    assert uncovered(model) is None
    assert uncovered_own(model, (name,)) == f"{name}: its body 'shelf' stands still and can be touched"


def test_a_fixed_body_that_nothing_touches_may_be_anywhere() -> None:
    model = mujoco.MjModel.from_xml_string(FIXED.format(board=UNTOUCHED, more=""))
    names, generator = ("body_pos", "body_quat"), np.random.default_rng(0)
    assert uncovered_own(model, names) is None
    datas = random_states(model, 0.3)
    models = [copy.copy(model) for _ in datas]
    for one, data in zip(models, datas, strict=True):
        for name in names:
            values = getattr(one, name)
            values[1:4] += 0.3 * generator.normal(size=values[1:4].shape)
        one.body_quat[:] /= np.linalg.norm(one.body_quat, axis=1, keepdims=True)
        mujoco.mj_forward(one, data)
    own = {name: list(np.stack([np.ravel(getattr(one, name)) for one in models], 1)) for name in names}
    state = state_of(datas)
    moved = substep(read_model(model, own), state, [])
    seen = derived(Scene(Fields(model, own), state.qpos, state.qvel), ("xpos", "xquat", "geom_xpos"))
    for field, numbers in seen.items():
        assert_close(numbers, list(np.stack([np.ravel(getattr(data, field)) for data in datas], 1)))
    for one, data in zip(models, datas, strict=True):
        mujoco.mj_step(one, data)
    assert_close(moved.qvel, of_all(datas, "qvel"), 1e-11)
