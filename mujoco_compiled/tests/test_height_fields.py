"""Contacts with height fields beside C MuJoCo's, and bodies that move on them."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from mujoco_compiled.collisions.fields import read_field
from mujoco_compiled.collisions.hulls import read_hull
from mujoco_compiled.collisions.prisms import Window
from mujoco_compiled.collisions.shapes import Placed, Touch
from mujoco_compiled.coverage import uncovered
from mujoco_compiled.data import make_data, step
from mujoco_compiled.model import put_model
from mujoco_compiled.program.arithmetic import select
from mujoco_compiled.program.interpret import interpret
from mujoco_compiled.program.memory import array
from mujoco_compiled.program.program import Program
from mujoco_compiled.tests.extra import extra
from mujoco_compiled.tests.states import converge, of_all
from mujoco_compiled.tests.test_contact_substep import assert_moves_as_mujoco, falling
from mujoco_compiled.tests.test_convex import STONE

Array = NDArray[np.float64]
NUM_STATES = 100
# Turned and shifted, with cells that are no squares, and of which no two neighbours are level.
HILLS = """
<mujoco>
  <option ccd_tolerance="1e-10" ccd_iterations="200"><flag multiccd="disable"/></option>
  <asset>
    <hfield name="hills" nrow="9" ncol="12" size="0.6 0.4 0.12 0.1" elevation="{}"/>
    <mesh name="stone" vertex="{}"/>
  </asset>
  <worldbody>
    <geom name="hills" type="hfield" hfield="hills" pos="1 2 3" euler="5 -8 30"/>
    <body><freejoint/><geom name="moves" type="{}" size="{}" {}/></body>
  </worldbody>
  <contact><pair geom1="hills" geom2="moves" margin="{}"/></contact>
</mujoco>
"""
SIZES = {
    "sphere": "0.07",
    "capsule": "0.03 0.1",
    "ellipsoid": "0.1 0.06 0.04",
    "cylinder": "0.05 0.06",
    "box": "0.08 0.05 0.03",
    "mesh": "1",
}


def hills(name: str, margin: float = 0.0) -> mujoco.MjModel:
    heights = np.random.default_rng(3).uniform(size=(9, 12))
    numbers = (" ".join(f"{x:.6f}" for x in np.ravel(values)) for values in (heights, STONE))
    mesh = 'mesh="stone"' if name == "mesh" else ""
    return mujoco.MjModel.from_xml_string(HILLS.format(*numbers, name, SIZES[name], mesh, margin))


def poses(model: mujoco.MjModel, depth: float) -> list[mujoco.MjData]:
    """A geom that is somewhere on the hills, up to this deep in them, or beyond the rim, or above."""
    generator, found = np.random.default_rng(0), list[mujoco.MjData]()
    while len(found) < NUM_STATES:
        data = mujoco.MjData(model)
        data.qpos[3:] = generator.normal(size=4)
        mujoco.mju_normalize4(data.qpos[3:])
        mujoco.mj_kinematics(model, data)
        turn, middle = data.geom_xmat[0].reshape(3, 3), data.geom_xpos[0]
        place = [*generator.uniform(-1.1, 1.1, size=2) * [0.6, 0.4], 0.3]
        data.qpos[:3] = middle + turn @ place
        mujoco.mj_forward(model, data)
        # Down, until it touches.
        while not data.ncon and place[2] > -0.1:
            place[2] -= 0.002
            data.qpos[:3] = middle + turn @ place
            mujoco.mj_forward(model, data)
        place[2] -= generator.uniform(-0.2 * depth, depth)
        data.qpos[:3] = middle + turn @ place
        mujoco.mj_forward(model, data)
        found.append(data)
    return found


def sums_of_mujoco(data: mujoco.MjData) -> Array:
    """How many points, and sums over them: distance, position, normal."""
    rows = [[1.0, one.dist, *one.pos, *one.frame[:3]] for one in data.contact]
    return np.sum(np.reshape(rows, (-1, 8)), axis=0)


def sums_of_ours(model: mujoco.MjModel, datas: list[mujoco.MjData]) -> Array:
    program, reach = Program(), float(model.pair_margin[0])
    found = array(program, "sums", 1, 8)
    found.store(0, [0.0] * 8)
    field, hull = read_field(model, 0), read_hull(model, 1)
    assert field is not None

    def placed(geom: int) -> Placed:
        own = program.inputs(f"geom {geom}", 12)
        turn = [own[3 * k : 3 * k + 3] for k in range(1, 4)]
        size = [float(x) for x in model.geom_size[geom]]
        unturned = np.eye(3).tolist()
        return Placed(own[:3], turn, unturned, size, hull if geom else None, None if geom else field)

    def put(touch: Touch) -> None:
        values = [1.0, touch.distance, *touch.position, *touch.normal]
        found.add(0, [select(touch.distance < reach, x, 0.0) for x in values])

    window = Window(program, "hills", field.window(float(model.geom_rbound[1]) + reach))
    window.each_touch(int(model.geom_type[1]), placed(0), placed(1), reach, put)
    program.output("sums", found.row(0))
    given = {
        f"geom {geom}": list(
            np.stack([[*data.geom_xpos[geom], *data.geom_xmat[geom]] for data in datas], axis=1)
        )
        for geom in (0, 1)
    }
    return np.stack(np.broadcast_arrays(*interpret(program, given)["sums"]), axis=1)


def compared(name: str, margin: float) -> tuple[Array, Array]:
    """Ours and MuJoCo's, of states with the same number of points, up to as many as there are."""
    model = hills(name, margin)
    datas = poses(model, depth=0.01)
    ours, theirs = sums_of_ours(model, datas), np.stack([sums_of_mujoco(data) for data in datas])
    assert set(theirs[:, 0]) >= {0, 1, 2, 3}
    np.testing.assert_array_equal(ours[:, 0], theirs[:, 0])
    return ours[:, 1:], theirs[:, 1:]


@pytest.mark.parametrize(
    ("name", "margin"), [("sphere", 0.0), ("capsule", 0.02), *extra(("sphere", 0.02), ("capsule", 0.0))]
)
def test_balls_and_capsules_touch_as_in_mujoco(name: str, margin: float) -> None:
    ours, theirs = compared(name, margin)
    np.testing.assert_allclose(ours, theirs, atol=1e-9)


@pytest.mark.parametrize("name", ["cylinder", *extra("ellipsoid")])
def test_round_geoms_touch_as_in_mujoco_but_for_some_normals(name: str) -> None:
    ours, theirs = compared(name, margin=0.0)
    off = np.quantile(np.abs(ours - theirs), 0.9, axis=0)
    assert off[0] < 1e-6
    assert (off[1:4] < 5e-5).all()
    assert (off[4:] < 2e-3).all()


@pytest.mark.parametrize("name", ["box", *extra("mesh")])
def test_geoms_with_edges_touch_as_in_mujoco_while_they_are_apart(name: str) -> None:
    # Where they overlap, MuJoCo's own search ends before the direction of least overlap.
    ours, theirs = compared(name, margin=0.02)
    np.testing.assert_allclose(ours, theirs, atol=1e-9)


def test_a_ball_in_the_middle_of_a_level_prism_has_one_point_straight_below() -> None:
    model = mujoco.MjModel.from_xml_string(
        """
      <mujoco>
        <asset><hfield name="table" nrow="3" ncol="2" size="1 1 0.5 0.1" elevation="1 1  1 1  0 0"/></asset>
        <worldbody>
          <geom type="hfield" hfield="table"/>
          <body pos="0.3 0.4 0.599"><freejoint/><geom size="0.1"/></body>
        </worldbody>
        <contact><pair geom1="0" geom2="1"/></contact>
      </mujoco>
    """.replace("<geom size", '<geom name="1" size').replace("<geom type", '<geom name="0" type')
    )
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    # 1 mm deep, midway between both surfaces; the slope, and the other half, are farther than its radius.
    np.testing.assert_allclose(
        sums_of_ours(model, [data])[0], [1.0, -0.001, 0.3, 0.4, 0.4995, 0.0, 0.0, 1.0], atol=1e-12
    )


BUMPS = """
<mujoco>
  <option timestep="0.002" cone="{}"/>
  <asset><hfield name="bumps" nrow="14" ncol="16" size="1.5 1.2 0.08 0.1" elevation="{}"/></asset>
  <default>
    <joint axis="0 1 0" damping="0.3" armature="0.01"/><geom friction="0.8" contype="0" conaffinity="1"/>
  </default>
  <worldbody>
    <geom name="ground" type="hfield" hfield="bumps" contype="1"/>
    {}
  </worldbody>
  <actuator>{}</actuator>
</mujoco>
"""
LEG = """
<body pos="{0} {1} 0"><joint name="hip {0} {1}" range="-60 60"/>
  <geom type="capsule" size="0.03" fromto="0 0 0 0.05 0 -0.15" mass="0.2"/>
  <body pos="0.05 0 -0.15"><joint name="knee {0} {1}" range="-90 60"/>
    <geom type="capsule" size="0.02" fromto="0 0 0 -0.04 0 -0.15" mass="0.1"/></body>
</body>
"""


def on_bumps(bodies: str, cone: str = "pyramidal") -> mujoco.MjModel:
    heights = np.random.default_rng(5).uniform(size=14 * 16)
    names = [part.split('"')[0] for part in bodies.split('joint name="')[1:]]
    motors = "".join(f'<motor joint="{name}" gear="4" ctrlrange="-1 1"/>' for name in names)
    return mujoco.MjModel.from_xml_string(
        BUMPS.format(cone, " ".join(f"{x:.5f}" for x in heights), bodies, motors)
    )


def quadruped(cone: str) -> mujoco.MjModel:
    """Of capsules: a trunk and four limbs of two."""
    legs = "".join(LEG.format(x, y) for x in (-0.2, 0.15) for y in (-0.12, 0.12))
    trunk = '<geom type="capsule" size="0.07" fromto="-0.2 0 0 0.2 0 0" mass="3"/>'
    return on_bumps(f'<body pos="0 0 0.4"><freejoint/>{trunk}{legs}</body>', cone)


@pytest.mark.parametrize("cone", ["pyramidal", *extra("elliptic")])
def test_a_quadruped_stands_and_walks_on_bumps_as_in_mujoco(cone: str) -> None:
    model = converge(quadruped(cone), implicit_damping=True)
    assert uncovered(model) is None
    datas = falling(model)
    touching = {int(one.geom[1]) for data in datas for one in data.contact}
    assert len(touching) > 5
    assert_moves_as_mujoco(model, datas, num_substeps=2)


def test_balls_roll_over_bumps_as_in_mujoco() -> None:
    geom = '<geom size="0.09" mass="1" condim="6" friction="1 0.1 0.01"/>'
    model = on_bumps(f'<body pos="0 0 0.2"><freejoint/>{geom}</body>')
    begun, num_substeps = falling(model), 100
    m = put_model(model, nstep=num_substeps)
    fields = {
        name: jnp.asarray(np.stack(of_all(begun, name), axis=1), jnp.float32)
        for name in ("qpos", "qvel", "qacc_warmstart")
    }
    d = jax.jit(jax.vmap(lambda own: step(m, make_data(m).replace(**own))))(fields)
    way = np.array([data.qpos[:2] for data in begun])
    for data in begun:
        mujoco.mj_step(model, data, num_substeps)
    moved = np.linalg.norm([data.qpos[:2] for data in begun] - way, axis=1)
    assert np.median(moved) > 0.05
    # In single precision, over 0.2 s, in which some of them leave a slope for the next.
    np.testing.assert_allclose(d.qpos, np.stack([data.qpos for data in begun]), atol=1e-3)


@pytest.mark.parametrize(
    ("size", "grid", "reason"),
    [
        ("0.5", 200, "the geom can be over 39,601 cells of the height field, more than 256"),
        ("0.01", 600, "the height field has 360,000 heights, more than 262,144"),
        ("0.01", 1, "the height field has no cells"),
    ],
)
def test_fields_that_are_too_fine_or_too_large_or_empty_are_named(size: str, grid: int, reason: str) -> None:
    spec = mujoco.MjSpec.from_string(f"""
      <mujoco><worldbody><geom name="hill" type="hfield" hfield="hill"/>
        <body><freejoint/><geom name="ball" size="{size}"/></body></worldbody>
        <asset><hfield name="hill" nrow="{grid}" ncol="{grid}" size="0.5 0.5 1 1"/></asset></mujoco>
    """)
    assert uncovered(spec.compile()) == f"its geoms 'hill' and 'ball' can touch: {reason}"
