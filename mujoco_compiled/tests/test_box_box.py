"""Two boxes beside C MuJoCo, in all positions in which they touch.

MuJoCo computes in double precision, and the stages have its constants for single precision. So three kinds of
positions differ:
- Edges that are parallel to 3e-4 rad: here a face decides, in MuJoCo the edges may.
- Points that are nearer to each other than 1e-5 of a face are one here, and two in MuJoCo. One of 17,000
  states at random had such points.
- Boxes of one size that lie on each other exactly: rounding gives MuJoCo points between the corners, too.
In two more kinds rounding decides between equals, here and in MuJoCo:
- Boxes that share their centre along the axis in which they overlap least: which way is out.
- A face that looks at two others under 45° exactly: which of these is clipped. Where boxes rest on an edge,
  both choices give that edge's two points.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from mujoco_compiled.collisions.box_box import box_box
from mujoco_compiled.collisions.shapes import Placed, Touch
from mujoco_compiled.program.interpret import interpret
from mujoco_compiled.program.program import Program
from mujoco_compiled.tests.test_ellipsoid_box import UNTURNED
from mujoco_compiled.tests.test_machine_code import run

Array = NDArray[np.float64]
NUM_STATES = 400
XML = """
<mujoco>
  <worldbody>
    <geom name="still" type="box" size="1 1 1" pos="1 2 3" euler="10 20 30"/>
    <body><freejoint/><geom name="moves" type="box" size="1 1 1"/></body>
  </worldbody>
  <contact><pair geom1="still" geom2="moves" margin="{}"/></contact>
</mujoco>
"""


@dataclass(frozen=True)
class States:
    """Of two boxes, the first of which stands still. sizes [n, 2, 3], positions [n, 2, 3], rotations
    [n, 2, 3, 3]."""

    sizes: Array
    positions: Array
    rotations: Array

    def placed(self, box: int) -> Placed:
        rotation = [list(row) for row in self.rotations[:, box].transpose(1, 2, 0)]
        return Placed(list(self.positions[:, box].T), rotation, UNTURNED, list(self.sizes[:, box].T))

    def points(self) -> Array:
        """Ours: distance, position and normal, [n, 8, 7]."""
        return points(box_box(self.placed(0), self.placed(1)))


def points(touches: list[Touch]) -> Array:
    numbers = [[one.distance, *one.position, *one.normal] for one in touches]
    return np.stack([np.stack(np.broadcast_arrays(*one), axis=-1) for one in numbers], axis=1)


def any_way(generator: np.random.Generator) -> Array:
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, normalized(generator.normal(size=4)))
    return rotation.reshape(3, 3)


def normalized(vector: Array) -> Array:
    return vector / np.linalg.norm(vector)


def parallel(generator: np.random.Generator) -> Array:
    """Its axes are those of the other box, in any order and with any signs."""
    rotation = np.eye(3)[generator.permutation(3)] * generator.choice([-1.0, 1.0], size=3)
    return rotation * np.linalg.det(rotation)


def about_an_axis(generator: np.random.Generator) -> Array:
    return turned(generator, generator.uniform(-np.pi, np.pi)) @ parallel(generator)


def on_an_edge(generator: np.random.Generator) -> Array:
    return turned(generator, 0.26 * np.pi) @ turned(generator, 0.24 * np.pi)


def tilted(generator: np.random.Generator, tilt: float | None = None) -> Array:
    rotation, angle = np.zeros(9), 10.0 ** generator.uniform(-3.0, -1.0) if tilt is None else tilt
    mujoco.mju_quat2Mat(rotation, normalized(np.eye(4)[0] + angle * generator.normal(size=4)))
    return parallel(generator) @ rotation.reshape(3, 3)


def turned(generator: np.random.Generator, angle: float) -> Array:
    rotation, quaternion = np.zeros(9), np.zeros(4)
    mujoco.mju_axisAngle2Quat(quaternion, np.eye(3)[generator.integers(3)], angle)
    mujoco.mju_quat2Mat(rotation, quaternion)
    return rotation.reshape(3, 3)


def states(turn: Callable[[np.random.Generator], Array], *, stacked: bool = False) -> States:
    """Boxes that overlap at random: half of them by less than 1 % of their distance.

    turn: the second box's rotation in the first one's frame. stacked: boxes of one size on each other, which
    all overlap by less than that.
    """
    generator = np.random.default_rng(0)
    sizes = generator.uniform(0.05, 0.5, size=(NUM_STATES, 2, 3))
    first = np.stack([any_way(generator) for _ in range(NUM_STATES)])
    second = first @ np.stack([turn(generator) for _ in range(NUM_STATES)])
    ways = generator.uniform(-1.0, 1.0, size=(NUM_STATES, 3))
    if stacked:
        sizes[:, 1], ways = sizes[:, 0], np.eye(3)[generator.integers(3, size=NUM_STATES)]
    ways = (first @ (ways * sizes.sum(axis=1))[:, :, None])[:, :, 0]
    position, rotations = generator.normal(size=(NUM_STATES, 3)), np.stack([first, second], axis=1)

    def apart(factor: Array) -> States:
        return States(sizes, np.stack([position, position + factor[:, None] * ways], axis=1), rotations)

    touching, away = np.zeros(NUM_STATES), np.full(NUM_STATES, 10.0)
    for _ in range(35):
        middle = 0.5 * (touching + away)
        overlaps = apart(middle).points()[:, :, 0].min(axis=1) < 0.0
        touching, away = np.where(overlaps, middle, touching), np.where(overlaps, away, middle)
    depth = 10.0 ** generator.uniform(-6.0, -2.0, size=NUM_STATES)
    if not stacked:
        depth[::2] = generator.uniform(0.0, 1.0, size=NUM_STATES // 2)
    return apart(touching * (1.0 - depth))


def of_mujoco(given: States, margin: float = 0.0) -> list[Array]:
    """By state, MuJoCo's points within the margin: distance, position and normal, [points, 7]."""
    model, found = mujoco.MjModel.from_xml_string(XML.format(margin)), list[Array]()
    for sizes, positions, rotations in zip(given.sizes, given.positions, given.rotations, strict=True):
        quaternions = np.zeros((2, 4))
        for quaternion, rotation in zip(quaternions, rotations, strict=True):
            mujoco.mju_mat2Quat(quaternion, rotation.ravel())
        model.geom_size[:], model.geom_rbound[:] = sizes, np.linalg.norm(sizes, axis=1)
        model.geom_pos[0], model.geom_quat[0] = positions[0], quaternions[0]
        data = mujoco.MjData(model)
        data.qpos[:] = [*positions[1], *quaternions[1]]
        mujoco.mj_forward(model, data)
        both = [(one.dist, *one.pos, *one.frame[:3]) for one in data.contact if one.dist <= margin]
        found.append(np.reshape(both, (-1, 7)))
    return found


def overlapping(ours: Array, margin: float = 0.0) -> list[Array]:
    return [one[one[:, 0] <= margin] for one in ours]


@pytest.mark.parametrize(
    ("turn", "expected"),
    [
        (any_way, range(1, 7)),
        (parallel, [4]),
        (about_an_axis, range(2, 9)),
        (on_an_edge, range(1, 7)),
        (tilted, range(1, 7)),
    ],
)
def test_boxes_touch_where_they_do_in_mujoco(
    turn: Callable[[np.random.Generator], Array], expected: Iterable[int]
) -> None:
    """expected: how many points there are in some of the states."""
    given = states(turn)
    numbers = set[int]()
    for ours, theirs in zip(overlapping(given.points()), of_mujoco(given), strict=True):
        assert len(ours) == len(theirs) > 0
        apart = np.abs(ours[:, None] - theirs).max(axis=2)
        assert max(apart.min(axis=0).max(), apart.min(axis=1).max()) < 1e-10
        numbers.add(len(ours))
    assert set(expected) <= numbers


@pytest.mark.parametrize("turn", [any_way, parallel, tilted])
def test_boxes_that_are_apart_touch_within_their_margin_as_in_mujoco(
    turn: Callable[[np.random.Generator], Array],
) -> None:
    margin, generator, given = 0.05, np.random.default_rng(1), states(turn)
    ways = np.diff(given.positions, axis=1)[:, 0]
    ways *= (generator.uniform(0.0, margin, size=NUM_STATES) / np.linalg.norm(ways, axis=1))[:, None]
    given.positions[:, 1] += ways
    apart = 0
    for ours, theirs in zip(overlapping(given.points(), margin), of_mujoco(given, margin), strict=True):
        assert len(ours) == len(theirs)
        if len(ours):
            between = np.abs(ours[:, None] - theirs).max(axis=2)
            assert max(between.min(axis=0).max(), between.min(axis=1).max()) < 1e-10
            apart += ours[:, 0].min() > 0.0
    assert apart > 0.3 * NUM_STATES


def test_either_box_may_be_the_first() -> None:
    given = states(any_way)
    swapped = points(box_box(given.placed(1), given.placed(0)))
    for ours, other in zip(overlapping(given.points()), overlapping(swapped), strict=True):
        apart = np.abs(ours[:, None] - other * [1.0, 1.0, 1.0, 1.0, -1.0, -1.0, -1.0]).max(axis=2)
        assert max(apart.min(axis=0).max(), apart.min(axis=1).max()) < 1e-10


def test_a_box_lies_on_one_of_its_size_with_its_four_corners() -> None:
    given = states(parallel_and_alike, stacked=True)
    for ours, theirs in zip(overlapping(given.points()), of_mujoco(given), strict=True):
        assert len(ours) == 4
        assert np.abs(ours[:, None] - theirs).max(axis=2).min(axis=1).max() < 1e-10
        # What MuJoCo has beyond is on the lines between the corners.
        ends = ours[:, 1:4]
        ways = ends[:, None] - ends
        lengths = np.linalg.norm(theirs[:, None, 1:4] - ends, axis=2)
        detours = lengths[:, :, None] + lengths[:, None] - np.linalg.norm(ways, axis=2)
        assert (detours + np.eye(4)).min(axis=(1, 2)).max() < 1e-10


def parallel_and_alike(_: np.random.Generator) -> Array:
    return np.eye(3)


def test_nearly_parallel_edges_are_as_deep_as_in_mujoco() -> None:
    given = states(lambda generator: tilted(generator, 10.0 ** generator.uniform(-9.0, -5.0)))
    for ours, theirs in zip(overlapping(given.points()), of_mujoco(given), strict=True):
        assert abs(ours[:, 0].min() - theirs[:, 0].min()) < 1e-5
        np.testing.assert_allclose(ours[0, 4:], theirs[0, 4:], atol=1e-4)


def test_machine_code_finds_the_same_points() -> None:
    """In single precision. Where another direction is as good but for rounding, the points are others."""
    given, program = states(any_way), Program()
    inputs = {"sizes": 6, "positions": 6, "rotations": 18}
    sizes, positions, rotations = (list(program.inputs(name, size)) for name, size in inputs.items())
    boxes = [
        Placed(
            positions[3 * box :][:3],
            [rotations[9 * box + 3 * row :][:3] for row in range(3)],
            UNTURNED,
            sizes[3 * box :][:3],
        )
        for box in range(2)
    ]
    program.output(
        "points", [x for one in box_box(*boxes) for x in (one.distance, *one.position, *one.normal)]
    )
    values = {name: list(getattr(given, name).reshape(NUM_STATES, -1).T) for name in inputs}
    exact, found = (np.stack(run_by(program, values)["points"]) for run_by in (interpret, run))
    np.testing.assert_allclose(exact, given.points().reshape(NUM_STATES, -1).T, rtol=0.0, atol=1e-12)
    apart = np.abs(found - exact).max(axis=0)
    assert np.count_nonzero(apart < 1e-4) > 0.98 * NUM_STATES
