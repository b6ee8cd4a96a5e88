"""Bodies with more contacts than are written out, whose contacts are in slots."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from mujoco_compiled import Data, Uncovered, put_model, step
from mujoco_compiled.constraints import contact_room
from mujoco_compiled.constraints.contact_room import most_points
from mujoco_compiled.constraints.contacts import read_contacts
from mujoco_compiled.fields import Fields
from mujoco_compiled.substep import SubstepState, read_model
from mujoco_compiled.tests.extra import extra
from mujoco_compiled.tests.recorded_substep import recorded
from mujoco_compiled.tests.states import THOROUGH, converge, of_all, relative
from mujoco_compiled.write import Plan, control_step_program

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


def test_environments_that_touch_at_more_points_than_there_are_slots_become_infinite(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(contact_room, "MOST_SLOTS", 2)
    model, states = begun()
    move = jax.vmap(partial(step, put_model(model, nstep=3)))
    moved = move(states)
    lost = np.isposinf(moved.qpos).all(axis=1)
    assert lost[0]
    # Those of a vector are lost together.
    assert not lost[-1]
    assert np.isfinite(moved.qpos[~lost]).all()
    assert np.isposinf(move(moved).qpos[lost]).all()
    broken = move(states.replace(qvel=states.qvel.at[-1].set(jnp.nan)))
    assert np.isnan(broken.qpos[-1]).all()


def test_room_that_is_not_used_changes_no_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    model, states = begun()
    found = list[np.ndarray]()
    for most in (64, 512):
        monkeypatch.setattr(contact_room, "MOST_SLOTS", most)
        found.append(np.asarray(jax.vmap(partial(step, put_model(model, nstep=40)))(states).qpos))
    np.testing.assert_array_equal(*found)
    assert np.isfinite(found[0]).all()


def boxes(number: int) -> mujoco.MjModel:
    """Boxes side by side on one of two floors, which touch nothing else."""
    each = "".join(
        f'<body pos="{k} 0 0.0999"><freejoint/>'
        '<geom type="box" size="0.1 0.1 0.1" contype="1" conaffinity="0"/></body>'
        for k in range(number)
    )
    floors = "".join(f'<geom type="plane" pos="0 0 {z}" size="5 5 1" contype="0"/>' for z in (0, -9, -9, -9))
    return mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{floors}{each}</worldbody></mujoco>")


def slots(model: mujoco.MjModel, nconmax: int | None = None, *, alone: bool = True) -> int:
    """Those that there are in a program."""
    sizes = {"qpos": model.nq, "qvel": model.nv, "qacc_warmstart": model.nv}
    program = control_step_program(Plan(model, sizes, (), (), nconmax), 1, alone=alone)
    return program.memory.lists["contacts 0 slots"]


def test_an_environment_alone_has_room_for_twice_the_contacts_of_a_simulation() -> None:
    # A box touches a floor at up to four points, and could touch at sixteen on four floors.
    model = boxes(12)
    contacts = read_contacts(Fields(model))
    assert most_points(model, contacts) == most_points(model, contacts) == {(3, False, True): 48}
    assert (slots(model), slots(model, alone=False)) == (96, 192)
    assert slots(boxes(5)) == 64
    assert (slots(model, 40), slots(model, 40, alone=False), slots(boxes(40), 600, alone=False)) == (
        40,
        192,
        600,
    )


def test_less_room_than_a_model_needs_where_it_begins_is_refused() -> None:
    with pytest.raises(Uncovered, match="touch at 48 points where it begins, more than its `nconmax` of 47"):
        put_model(boxes(12), nconmax=47)
    with pytest.raises(ValueError, match=r"nconmax is 1,025; it must be from 1 to 1,024"):
        put_model(boxes(12), nconmax=1025)
