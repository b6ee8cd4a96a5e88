"""A cylinder and a box, beside all of C MuJoCo's points, in double precision and in machine code."""

from collections.abc import Callable, Iterator

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from mujoco_compiled.collisions.cylinder_box import cylinder_box
from mujoco_compiled.collisions.shapes import Placed
from mujoco_compiled.program.arithmetic import Vector
from mujoco_compiled.program.program import Program
from mujoco_compiled.tests.test_ellipsoid_box import UNTURNED
from mujoco_compiled.tests.test_machine_code import run

Array = NDArray[np.float64]
# Of a cylinder in a box's frame: its place and its rotation.
Pose = Callable[[np.random.Generator], tuple[Array, Array]]
NUM_STATES = 60
RADIUS, LENGTH, BOX = 0.1, 0.15, (0.3, 0.2, 0.1)
XML = f"""
<mujoco>
  <worldbody>
    <geom type="box" size="{" ".join(map(str, BOX))}" pos="0.1 0.2 0.3" euler="10 20 30"/>
    <body><freejoint/><geom type="cylinder" size="{RADIUS} {LENGTH}"/></body>
  </worldbody>
</mujoco>
"""
INPUTS = {"cylinder": 12, "box": 12}


def about(axis: list[float], angle: float) -> Array:
    quaternion, rotation = np.zeros(4), np.zeros(9)
    mujoco.mju_axisAngle2Quat(quaternion, np.array(axis), angle)
    mujoco.mju_quat2Mat(rotation, quaternion)
    return rotation.reshape(3, 3)


def turned(tilt: float, generator: np.random.Generator) -> Array:
    """Upright but for a tilt in a random direction, after a turn about its axis."""
    turn, way = generator.uniform(0.0, 2.0 * np.pi, size=2)
    return about([np.cos(way), np.sin(way), 0.0], tilt) @ about([0.0, 0.0, 1.0], turn)


def on_its_side(generator: np.random.Generator) -> tuple[Array, Array]:
    """2 mm deep, and 0.2 degrees or less from level."""
    rotation = about([1.0, 0.0, 0.0], 0.5 * np.pi + generator.uniform(-0.003, 0.003))
    rotation = about([0.0, 0.0, 1.0], generator.uniform(0.0, np.pi)) @ rotation
    return np.array([*generator.uniform(-0.25, 0.25, size=2), BOX[2] + RADIUS - 0.002]), rotation


def at_an_edge(generator: np.random.Generator) -> tuple[Array, Array]:
    """Along it, but for a turn about the way to it."""
    angle = generator.uniform(0.3, 1.2)
    way = np.array([0.0, np.cos(angle), np.sin(angle)])
    rotation = about(way.tolist(), generator.uniform(-0.06, 0.06)) @ about([0.0, 1.0, 0.0], 0.5 * np.pi)
    edge = np.array([generator.uniform(-0.2, 0.2), BOX[1], BOX[2]])
    return edge + (RADIUS - 0.002) * way, rotation


def at_a_large_angle(generator: np.random.Generator) -> tuple[Array, Array]:
    rotation = turned(generator.uniform(0.2, 1.2), generator)
    lowest = RADIUS * np.linalg.norm(rotation[2, :2]) + LENGTH * abs(rotation[2, 2])
    return np.array([*generator.uniform(-0.1, 0.1, size=2), BOX[2] + lowest - 0.002]), rotation


def over_a_corner(generator: np.random.Generator) -> tuple[Array, Array]:
    """Its end, of which the face's corner and two of its edges leave a part."""
    place = np.array([BOX[0] + 0.05, BOX[1] + 0.05, BOX[2] + LENGTH - 0.004])
    return place + 0.01 * generator.normal(size=3) * [1.0, 1.0, 0.0], turned(
        generator.uniform(0.0, 0.02), generator
    )


def points(make: Pose) -> tuple[dict[str, Array], list[Array]]:
    """Inputs of `cylinder_box`, and C MuJoCo's points of each state [n, 7]."""
    model, generator = mujoco.MjModel.from_xml_string(XML), np.random.default_rng(0)
    given, found = {name: np.zeros((NUM_STATES, size)) for name, size in INPUTS.items()}, list[Array]()
    for state in range(NUM_STATES):
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        to_world, (place, rotation) = data.geom_xmat[0].reshape(3, 3), make(generator)
        data.qpos[:3] = data.geom_xpos[0] + to_world @ place
        mujoco.mju_mat2Quat(data.qpos[3:], (to_world @ rotation).ravel())
        mujoco.mj_forward(model, data)
        for name, geom in (("box", 0), ("cylinder", 1)):
            given[name][state] = [*data.geom_xpos[geom], *data.geom_xmat[geom]]
        # The normal is from the cylinder, which is the first of the two in MuJoCo's order of kinds.
        each = [[one.dist, *one.pos, *one.frame[:3]] for one in data.contact]
        found.append(np.array(each).reshape(-1, 7))
    return given, found


def placed(numbers: Vector, size: tuple[float, ...]) -> Placed:
    rotation = [numbers[3 + row : 6 + row] for row in (0, 3, 6)]
    return Placed(numbers[:3], rotation, UNTURNED, list(size))


def touches(cylinder: Vector, box: Vector) -> list[Vector]:
    found = cylinder_box(placed(cylinder, (RADIUS, LENGTH, 0.0)), placed(box, BOX))
    return [[one.distance, *one.position, *one.normal] for one in found]


def by_numpy(given: dict[str, Array]) -> Array:
    """Of each state's four points: distance, position and normal, [n, 4, 7]."""
    found = touches(*(list(given[name].T) for name in INPUTS))
    return np.array([[np.broadcast_to(x, NUM_STATES) for x in one] for one in found]).transpose(2, 0, 1)


def by_machine_code(given: dict[str, Array]) -> Array:
    program = Program()
    found = touches(*(list(program.inputs(name, size)) for name, size in INPUTS.items()))
    program.output("points", [x for one in found for x in one])
    values = {name: list(numbers.T) for name, numbers in given.items()}
    return run(program, values)["points"].T.reshape(NUM_STATES, 4, 7)


def differences(ours: Array, theirs: list[Array]) -> Iterator[float]:
    """By state, how far points are from each other's nearest, in m; 1 if they are not as many."""
    for mine, expected in zip(ours, theirs, strict=True):
        mine = mine[mine[:, 0] < 0.0]
        if not len(mine) == len(expected) > 0:
            yield 1.0
            continue
        each = np.abs(mine[:, None] - expected[None]).max(axis=2)
        yield max(each.min(axis=0).max(), each.min(axis=1).max())


# A side's line lies to 4e-4 m where MuJoCo has it, whose search ends within 1e-6 m of the deepest one: it is
# √(2 · 0.1 m · 1e-6 m) away. Where an edge cuts it off, its ends move by some times as much.
@pytest.mark.parametrize(
    ("make", "share", "within"),
    [
        (on_its_side, 0.9, 4e-4),
        (at_a_large_angle, 1.0, 4e-4),
        (at_an_edge, 0.5, 5e-3),
        (over_a_corner, 0.8, 1e-6),
    ],
)
@pytest.mark.parametrize("compute", [by_numpy, by_machine_code])
def test_a_cylinder_touches_a_box_as_in_mujoco(
    make: Pose, share: float, within: float, compute: Callable[[dict[str, Array]], Array]
) -> None:
    given, theirs = points(make)
    found = np.array(list(differences(compute(given), theirs)))
    assert np.quantile(found, share) < within
