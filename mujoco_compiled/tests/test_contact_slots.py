"""Bodies with more contacts than are written out, whose contacts are in slots."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from mujoco_compiled import Data, put_model, step
from mujoco_compiled.constraints import contact_slots
from mujoco_compiled.substep import SubstepState, read_model
from mujoco_compiled.tests.extra import extra
from mujoco_compiled.tests.recorded_substep import recorded
from mujoco_compiled.tests.states import THOROUGH, converge, of_all, relative

NUM_STATES, NUM_ENVS = 6, 33


def heap(num_bodies: int, *, touch_each_other: bool, cone: str = "pyramidal", condim: int = 3) -> str:
    """Bodies with an arm each, one above the other: 7 degrees of freedom each."""
    kind = f'contype="1" conaffinity="{int(touch_each_other)}" condim="{condim}"'
    bodies = "".join(
        f"""
        <body pos="{0.05 * (-1) ** number} {0.03 * number} {0.12 + 0.19 * number}"><freejoint/>
          <geom type="capsule" size="0.1 0.2" euler="0 90 {40 * number}" {kind}/>
          <body pos="0.1 0.05 0"><joint axis="0 1 0" range="-40 60" damping="0.1"/>
            <geom type="sphere" size="0.08" pos="0.25 0 0" {kind}/></body>
        </body>"""
        for number in range(num_bodies)
    )
    return f"""
    <mujoco><option timestep="0.004" cone="{cone}" iterations="4" ls_iterations="8"/>
      <default><geom friction="0.8 0.01 0.001"/></default>
      <worldbody>
        <geom type="plane" size="5 5 1" contype="0"/>
        <geom type="box" size="0.3 0.3 0.1" pos="0.6 0.2 0" contype="0"/>
        {bodies}
      </worldbody>
    </mujoco>"""


def fallen(model: mujoco.MjModel) -> list[mujoco.MjData]:
    """States in which bodies fall on each other."""
    found = list[mujoco.MjData]()
    for number in range(NUM_STATES):
        data = mujoco.MjData(model)
        data.qvel[:] = 0.3 * np.random.default_rng(number).normal(size=model.nv)
        mujoco.mj_step(model, data, 60)
        assert data.ncon
        found.append(data)
    return found


# 14 degrees of freedom: all is written out but contacts; 28: the matrix is in loops; 42: the tree, too.
# Bodies that do not touch each other have a matrix of the tree's entries alone.
@pytest.mark.parametrize(
    ("num_bodies", "touch_each_other", "cone", "condim"),
    [
        (2, True, "pyramidal", 3),
        (4, True, "elliptic", 4),
        (6, False, "elliptic", 3),
        *extra((5, False, "pyramidal", 1), (6, True, "pyramidal", 6), (3, False, "pyramidal", 4)),
    ],
)
def test_a_body_with_contacts_in_slots_moves_as_in_mujoco(
    num_bodies: int, touch_each_other: bool, cone: str, condim: int
) -> None:
    xml = heap(num_bodies, touch_each_other=touch_each_other, cone=cone, condim=condim)
    model = converge(mujoco.MjModel.from_xml_string(xml), implicit_damping=True)
    datas, ours = fallen(model), read_model(model)
    assert ours.constraints.are_in_slots
    pairs = [model.geom_bodyid[contact.geom] for data in datas for contact in data.contact]
    assert any(pair.all() for pair in pairs) == touch_each_other
    ours = replace(ours, solver=replace(ours.solver, **THOROUGH))
    fields = ("qpos", "qvel", "act", "qacc_warmstart")
    state = SubstepState(*([] if field == "act" else of_all(datas, field) for field in fields))
    moved = recorded(ours, state, [])(state, [])
    for data in datas:
        mujoco.mj_step(model, data)
    assert relative(moved.qacc, of_all(datas, "qacc")) < 1e-8
    assert relative(moved.qvel, of_all(datas, "qvel")) < 1e-9


def begun() -> tuple[mujoco.MjModel, Data]:
    """Heaps at different heights: the last ones do not touch anything."""
    model = mujoco.MjModel.from_xml_string(heap(3, touch_each_other=True))
    qpos = np.tile(model.qpos0, (NUM_ENVS, 1))
    for body in range(3):
        qpos[:, 8 * body + 2] += np.linspace(0.0, 1.0 + body, NUM_ENVS)
    zeros = {name: jnp.zeros((NUM_ENVS, model.nv)) for name in ("qvel", "qacc_warmstart")}
    empty = {name: jnp.zeros((NUM_ENVS, 0)) for name in ("act", "ctrl")}
    return model, Data(qpos=jnp.asarray(qpos, jnp.float32), time=jnp.zeros(NUM_ENVS), **zeros, **empty)


def test_an_environment_moves_alone_as_it_does_beside_others() -> None:
    model, states = begun()
    move = jax.jit(jax.vmap(partial(step, put_model(model, nstep=20))))
    together = np.asarray(move(states).qpos)
    each = (jax.tree.map(lambda x, i=i: x[i : i + 1], states) for i in range(NUM_ENVS))
    np.testing.assert_array_equal(together, np.concatenate([np.asarray(move(one).qpos) for one in each]))
    assert np.isfinite(together).all()


def test_environments_that_touch_at_more_points_than_there_are_slots_become_nan(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(contact_slots, "MOST_SLOTS", 2)
    model, states = begun()
    moved = np.asarray(jax.vmap(partial(step, put_model(model, nstep=3)))(states).qpos)
    broken = np.isnan(moved).all(axis=1)
    assert broken[0]
    # Those of a vector break together.
    assert not broken[-1]
    assert not np.isnan(moved[~broken]).any()
