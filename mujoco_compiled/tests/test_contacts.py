"""Contacts of each kind of geoms, and each kind of row, against C MuJoCo in states that overlap at random."""

import mujoco
import numpy as np
import pytest

from mujoco_compiled.constraints.body_rows import BodyGroup
from mujoco_compiled.constraints.laws import RowGroup
from mujoco_compiled.constraints.rows import by_group, curvature, pulled_back, times
from mujoco_compiled.coverage import uncovered
from mujoco_compiled.fields import NOMINAL
from mujoco_compiled.program.arithmetic import Vector
from mujoco_compiled.tests.rows_of_mujoco import Array, assert_same_rows, rows_of

NUM_STATES = 100
# Two arms of a tree whose ends meet, and what stands still.
MEETING = """
<mujoco>
  <option {option}/>
  <default><geom {default}/></default>
  <worldbody>
    {world}
    <body name="trunk" pos="0 0 0.5">
      <freejoint/>
      <geom size="0.02" contype="0" conaffinity="0"/>
      <body name="left">
        <joint name="a" type="ball" armature="0.1"/><joint name="b" type="slide" axis="1 0 0"/>
        {left}
      </body>
      <body name="right">
        <joint name="c" type="ball" armature="0.1"/><joint name="d" type="slide" axis="0 1 0"/>
        {right}
      </body>
    </body>
  </worldbody>
  {more}
</mujoco>
"""
PLANE = '<geom name="still" type="plane" size="5 5 1" euler="10 20 0" pos="0 0 0.4"/>'
BOX = '<body pos="0.1 0 0.3" euler="10 20 30"><geom name="still" type="box" size="0.2 0.3 0.25"/></body>'
BALL = '<geom name="left" type="sphere" size="0.2" pos="0.05 0 0"/>'
BLOCK = '<geom name="block" type="box" size="0.1 0.15 0.2" pos="0.05 0 0" euler="30 20 0"/>'
ROD = '<geom name="rod" type="capsule" size="0.1 0.2" euler="20 50 0"/>'


def meeting(
    world: str = "", left: str = "", right: str = "", option: str = "", default: str = "", more: str = ""
) -> mujoco.MjModel:
    still = left or '<geom size="0.1" contype="0" conaffinity="0"/>'
    other = right or '<geom size="0.1" contype="0" conaffinity="0"/>'
    parts = {"world": world, "left": still, "right": other}
    return mujoco.MjModel.from_xml_string(MEETING.format(option=option, default=default, more=more, **parts))


def at_random(
    model: mujoco.MjModel, spread: tuple[float, float, float] = (0.3, 0.3, 0.3)
) -> list[mujoco.MjData]:
    generator = np.random.default_rng(0)
    datas = [mujoco.MjData(model) for _ in range(NUM_STATES)]
    for data in datas:
        data.qpos[:3] += generator.uniform(-1.0, 1.0, size=3) * spread
        data.qpos[3:] += generator.normal(scale=0.5, size=model.nq - 3)
        data.qpos[[11, 16]] *= 0.2
        data.qvel[:] = generator.normal(size=model.nv)
        mujoco.mj_normalizeQuat(model, data.qpos)
        mujoco.mj_forward(model, data)
    return datas


def assert_touches_as_mujoco(model: mujoco.MjModel) -> None:
    assert uncovered(model) is None
    datas = at_random(model)
    assert sum(data.nefc > 0 for data in datas) > NUM_STATES / 10
    assert_same_rows(model, datas)


@pytest.mark.parametrize(
    ("world", "left", "right"),
    [
        (PLANE, BALL, ""),
        (PLANE, ROD, ""),
        (PLANE, '<geom type="ellipsoid" size="0.1 0.2 0.3"/>', ""),
        (PLANE, '<geom type="box" size="0.1 0.2 0.3" pos="0.1 0 0" euler="10 20 30"/>', ""),
        (PLANE, '<geom type="cylinder" size="0.15 0.2" euler="10 20 30"/>', ""),
        (BOX, BALL, ""),
        (BOX, ROD, ""),
        (BOX, '<geom type="capsule" size="0.05 0.6" euler="20 50 0"/>', ""),
        (BOX, BLOCK, ""),
        ("", BLOCK, '<geom type="box" size="0.2 0.1 0.3"/>'),
        ("", '<geom type="box" size="0.2 0.3 0.25"/>', '<geom type="capsule" size="0.05 0.3"/>'),
        ("", BALL, '<geom size="0.1"/>'),
        ("", BALL, '<geom type="capsule" size="0.05 0.3"/>'),
        ("", ROD, '<geom type="capsule" size="0.05 0.3"/>'),
        ('<geom type="capsule" size="0.05 0.3" pos="0 0 0.5"/>', ROD, ""),
    ],
)
def test_geoms_touch_as_in_mujoco(world: str, left: str, right: str) -> None:
    assert_touches_as_mujoco(meeting(world, left, right))


def test_an_ellipsoid_lies_on_a_box_as_in_mujoco() -> None:
    box = '<geom type="box" size="5 5 0.5" euler="10 20 30" pos="0 0 -0.2"/>'
    ellipsoid = '<geom type="ellipsoid" size="0.1 0.2 0.15" euler="10 20 30"/>'
    model = meeting(box, ellipsoid, option='ccd_tolerance="1e-14" ccd_iterations="200"')
    assert uncovered(model) is None
    datas = at_random(model)
    assert sum(data.ncon > 0 for data in datas) > NUM_STATES / 10
    # More exactly MuJoCo does not find the normal of geoms that are only convex.
    assert_same_rows(model, datas, accuracy=1e-7)


@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
@pytest.mark.parametrize("condim", [1, 3, 4, 6])
def test_friction_has_mujoco_s_directions(cone: str, condim: int) -> None:
    default = f'condim="{condim}" friction="0.8 0.2 0.1"'
    assert_touches_as_mujoco(meeting(PLANE, BALL, ROD, f'cone="{cone}" impratio="4"', default))


@pytest.mark.parametrize(
    "default",
    [
        'solref="-1000 -30"',
        'solref="0.03 0.7" solimp="0.5 0.9 0.1 0.3 3"',
        'solimp="0.5 0.9 0.1 0.6 1"',
        'solimp="0.5 0.9 0.1 0.6 2.5"',
        'solimp="0.5 0.9 0 0.6 2"',
        'margin="0.1" gap="0.05"',
        'friction="0.02 0 0"',
    ],
)
def test_contacts_are_as_soft_as_in_mujoco(default: str) -> None:
    assert_touches_as_mujoco(meeting(PLANE, BALL, ROD, default=default))


def test_boxes_push_within_their_margin_as_in_mujoco() -> None:
    assert_touches_as_mujoco(meeting(BOX, BLOCK, default='margin="0.1" gap="0.05"'))


def test_contacts_in_a_cone_without_friction_are_mujoco_s() -> None:
    # Pyramids without friction are refused.
    default = 'friction="0 0 0"'
    assert_touches_as_mujoco(meeting(PLANE, BALL, ROD, option='cone="elliptic"', default=default))


@pytest.mark.parametrize(
    "own",
    [
        'priority="1" friction="0.3 0.2 0.1" condim="4" solref="0.05 1"',
        'priority="-1" friction="0.3 0.2 0.1" condim="4"',
        'solmix="3" solref="0.05 0.5" solimp="0.5 0.6 0.1"',
        'solmix="0" solref="0.05 0.5"',
        'solref="-500 -20"',
    ],
)
def test_two_geoms_parameters_mix_as_in_mujoco(own: str) -> None:
    assert_touches_as_mujoco(meeting(PLANE, BALL.replace("/>", f" {own}/>"), ROD))


@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
def test_a_listed_pair_has_parameters_of_its_own(cone: str) -> None:
    pair = """<contact>
      <pair geom1="left" geom2="still" condim="6" friction="0.9 0.5 0.1 0.2 0.3" solref="0.04 1"
            solreffriction="0.03 1" margin="0.02"/>
    </contact>"""
    assert_touches_as_mujoco(meeting(PLANE, BALL, ROD, f'cone="{cone}"', more=pair))


def test_of_many_fixed_boxes_each_is_touched() -> None:
    boxes = [
        f'<geom type="box" size="{0.9 + 0.05 * (k % 3)} 0.5 0.2" pos="{2.0 * k - 4.0} 0 {0.1 * (k % 2)}"/>'
        for k in range(5)
    ]
    model = meeting("".join(boxes), BALL + BLOCK, '<geom type="capsule" size="0.1 0.3"/>')
    datas = at_random(model, spread=(5.0, 0.5, 0.1))
    touched = {int(geom) for data in datas for geom in data.contact.geom1} | {
        int(geom) for data in datas for geom in data.contact.geom2
    }
    assert set(range(5)) < touched
    assert_same_rows(model, datas)


@pytest.mark.parametrize(
    ("tag", "attributes"),
    [
        ("ball", 'type="ball" limited="true" range="0 30"'),
        ("hinge", 'type="hinge" limited="true" range="-20 30" margin="0.1"'),
        ("loss", 'type="ball" frictionloss="2" solreffriction="0.03 1" solimpfriction="0.5 0.8 0.1"'),
    ],
)
def test_joints_rows_are_mujoco_s(tag: str, attributes: str) -> None:
    model = mujoco.MjModel.from_xml_string(f"""
      <mujoco><worldbody><body><freejoint/><geom size="0.1"/>
        <body><joint {attributes}/><geom size="0.1" pos="0 0 0.3"/></body>
      </body></worldbody></mujoco>
    """)
    assert uncovered(model) is None, tag
    generator = np.random.default_rng(0)
    datas = [mujoco.MjData(model) for _ in range(NUM_STATES)]
    for data in datas:
        data.qpos[:] += generator.normal(size=model.nq)
        data.qvel[:] = generator.normal(size=model.nv)
        mujoco.mj_forward(model, data)
    assert_same_rows(model, datas)


@pytest.mark.parametrize("own", [False, True])
def test_tendons_rows_are_mujoco_s(own: bool) -> None:
    model = mujoco.MjModel.from_xml_string("""
      <mujoco><default><geom contype="0" size="0.1"/></default>
      <worldbody><body><freejoint/><geom/>
        <body><joint name="a"/><geom pos="0 0 0.3"/></body>
        <body><joint name="b" axis="1 0 0"/><joint name="c" type="slide"/><geom pos="0 0.3 0"/></body>
      </body></worldbody>
      <tendon>
        <fixed limited="true" range="-0.2 0.3" margin="0.05" solreflimit="0.03 0.8" solimplimit="0.5 0.9 0.1">
          <joint joint="a" coef="-2"/><joint joint="b" coef="0.5"/></fixed>
        <fixed frictionloss="0.3" solreffriction="0.05 1" solimpfriction="0.6 0.9 0.1">
          <joint joint="c" coef="1.5"/><joint joint="a" coef="1"/></fixed>
      </tendon></mujoco>
    """)
    assert uncovered(model) is None
    datas, weights = [mujoco.MjData(model) for _ in range(NUM_STATES)], list[Array]()
    generator = np.random.default_rng(0)
    for data in datas:
        data.qpos[:] += generator.normal(size=model.nq, scale=0.3)
        data.qvel[:] = generator.normal(size=model.nv)
        if own:
            model.tendon_invweight0[:] = generator.uniform(0.5, 2.0, size=2)
        weights.append(model.tendon_invweight0.copy())
        mujoco.mj_forward(model, data)
    assert {data.nefc for data in datas} == {1, 2}
    assert_same_rows(model, datas, {"tendon_invweight0": list(np.stack(weights, 1))} if own else NOMINAL)


@pytest.mark.parametrize(
    ("left", "right", "kind"),
    [
        (BALL, ROD, RowGroup),
        ('<geom type="box" size="0.1 0.2 0.3"/><geom type="box" size="0.3 0.1 0.1"/>', ROD, BodyGroup),
    ],
)
def test_products_are_those_of_the_rows_entries(left: str, right: str, kind: type) -> None:
    model = meeting(PLANE, left, right)
    rows = rows_of(model, at_random(model))
    assert isinstance(rows.groups[0], kind)
    entries = [times(rows, list(one)) for one in np.eye(model.nv)]
    columns = np.array([[np.broadcast_to(x, NUM_STATES) for x in column] for column in entries])
    num_directions = columns.shape[1]
    moved: Vector = list(np.random.default_rng(0).normal(size=(num_directions, NUM_STATES)))
    pulled = np.stack(pulled_back(rows, moved, model.nv))
    np.testing.assert_allclose(pulled, np.einsum("ids,ds->is", columns, np.stack(moved)), atol=1e-9)
    expected = np.zeros((model.nv, model.nv, NUM_STATES))
    place = 0
    for group, own in by_group(rows, moved):
        weights = np.array([[np.broadcast_to(x, NUM_STATES) for x in row] for row in group.law.weights(own)])
        some = columns[:, place : place + group.size]
        expected += np.einsum("ias,abs,jbs->ijs", some, weights, some)
        place += group.size
    found = np.zeros_like(expected)
    for (i, j), terms in curvature(rows, moved).items():
        found[i, j] = found[j, i] = sum(terms)
    np.testing.assert_allclose(found, expected, atol=1e-11 * np.abs(expected).max())
