"""Convex geoms beside C MuJoCo with its iterations converged.

MuJoCo's own search for more points (`multiccd`) is off: with it one in twenty random poses of cylinders has a
normal that is far from the one of least overlap. Where a geom lies on a face, points have tests of their own.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from mujoco_compiled.collisions.hulls import Hull, read_hull
from mujoco_compiled.collisions.planes import plane_mesh
from mujoco_compiled.collisions.shapes import AWAY, Placed, Touch
from mujoco_compiled.collisions.table import COLLIDERS
from mujoco_compiled.program.program import Program
from mujoco_compiled.tests.test_ellipsoid_box import UNTURNED
from mujoco_compiled.tests.test_machine_code import run

Array = NDArray[np.float64]
NUM_STATES, MARGIN = 200, 0.02
# Of a stone with 24 corners.
_WAYS = np.random.default_rng(1).normal(size=(24, 3))
STONE = _WAYS / np.linalg.norm(_WAYS, axis=1)[:, None] * [0.1, 0.08, 0.06]
XML = """
<mujoco>
  <option ccd_tolerance="1e-10" ccd_iterations="200"><flag multiccd="disable"/></option>
  <asset><mesh name="stone" vertex="{}"/></asset>
  <worldbody>
    <geom name="still" type="{}" size="1 1 1" pos="1 2 3" euler="10 20 30"/>
    <body><freejoint/><geom name="moves" type="{}" size="1 1 1" {}/></body>
  </worldbody>
  <contact><pair geom1="still" geom2="moves" margin="{}"/></contact>
</mujoco>
"""
CONVEX = [
    ("sphere", "cylinder"),
    ("sphere", "ellipsoid"),
    ("capsule", "ellipsoid"),
    ("capsule", "cylinder"),
    ("ellipsoid", "ellipsoid"),
    ("ellipsoid", "cylinder"),
    ("cylinder", "cylinder"),
]
WITH_A_MESH = [(kind, "mesh") for kind in ("sphere", "capsule", "ellipsoid", "cylinder", "box")]


def model_of(kinds: tuple[str, str]) -> mujoco.MjModel:
    vertices = " ".join(f"{x:.6f}" for x in STONE.ravel())
    mesh = 'mesh="stone"' if kinds[1] == "mesh" else ""
    return mujoco.MjModel.from_xml_string(XML.format(vertices, *kinds, mesh, MARGIN))


def kind(name: str) -> int:
    return int(getattr(mujoco.mjtGeom, f"mjGEOM_{name.upper()}"))


@dataclass(frozen=True)
class States:
    """Of two geoms. sizes [n, 2, 3], positions [n, 2, 3], rotations [n, 2, 3, 3]. hull: of the second."""

    kinds: tuple[str, str]
    sizes: Array
    positions: Array
    rotations: Array
    hull: Hull | None

    def touches(self) -> list[Touch]:
        collide, num_points = COLLIDERS[kind(self.kinds[0]), kind(self.kinds[1])]
        found = collide(*(self.placed(geom) for geom in range(2)))
        assert len(found) == num_points
        return found

    def placed(self, geom: int) -> Placed:
        rotation = [list(row) for row in self.rotations[:, geom].transpose(1, 2, 0)]
        hull = self.hull if geom else None
        return Placed(list(self.positions[:, geom].T), rotation, UNTURNED, list(self.sizes[:, geom].T), hull)

    def deepest(self) -> Array:
        """Ours: distance, position and normal, [n, 7]."""
        return deepest(np.stack([numbers(one, len(self.sizes)) for one in self.touches()], axis=1))


def numbers(touch: Touch, num_states: int) -> Array:
    """[n, 7]."""
    parts = (touch.distance, *touch.position, *touch.normal)
    return np.stack([np.broadcast_to(x, num_states) for x in parts], axis=1)


def deepest(points: Array) -> Array:
    """Of each state's points [n, points, 7]."""
    return points[np.arange(len(points)), points[:, :, 0].argmin(axis=1)]


def states(kinds: tuple[str, str]) -> States:
    """Geoms that overlap by up to 10 mm, or are apart by up to the margin."""
    generator = np.random.default_rng(0)
    sizes, model = generator.uniform(0.03, 0.2, size=(NUM_STATES, 2, 3)), model_of(kinds)
    if (hull := read_hull(model, 1)) is not None:
        sizes[:, 1] = model.geom_size[1]
    quaternions = generator.normal(size=(NUM_STATES, 2, 4))
    rotations, positions = np.zeros((NUM_STATES, 2, 9)), np.zeros((NUM_STATES, 2, 3))
    for quaternion, rotation in zip(quaternions.reshape(-1, 4), rotations.reshape(-1, 9), strict=True):
        mujoco.mju_quat2Mat(rotation, quaternion / np.linalg.norm(quaternion))
    rotations = rotations.reshape(NUM_STATES, 2, 3, 3)
    ways = generator.normal(size=(NUM_STATES, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]

    def apart(length: Array) -> States:
        both = np.stack([positions[:, 0], positions[:, 1] + length[:, None] * ways], axis=1)
        return States(kinds, sizes, both, rotations, hull)

    touching, away = np.zeros(NUM_STATES), np.full(NUM_STATES, 2.0)
    for _ in range(20):
        middle = 0.5 * (touching + away)
        overlaps = apart(middle).deepest()[:, 0] < 0.0
        touching, away = np.where(overlaps, middle, touching), np.where(overlaps, away, middle)
    return apart(touching + generator.uniform(-0.01, MARGIN, size=NUM_STATES))


def of_mujoco(given: States) -> Array:
    """By state, MuJoCo's deepest point: distance, position and normal, [n, 7]; NaN if it has none."""
    model = model_of(given.kinds)
    # Geoms are where their bodies are: a mesh's compiler has moved and turned it.
    model.geom_sameframe[:], model.geom_pos[1], model.geom_quat[1] = 0, 0.0, [1.0, 0.0, 0.0, 0.0]
    found = np.full((NUM_STATES, 7), np.nan)
    for place, (sizes, positions, rotations) in enumerate(
        zip(given.sizes, given.positions, given.rotations, strict=True)
    ):
        quaternions = np.zeros((2, 4))
        for quaternion, rotation in zip(quaternions, rotations, strict=True):
            mujoco.mju_mat2Quat(quaternion, rotation.ravel())
        model.geom_size[:] = sizes
        model.geom_rbound[: 1 if given.hull else 2] = (
            2.0 * np.linalg.norm(sizes, axis=1)[: 1 if given.hull else 2]
        )
        model.geom_pos[0], model.geom_quat[0] = positions[0], quaternions[0]
        data = mujoco.MjData(model)
        data.qpos[:] = [*positions[1], *quaternions[1]]
        mujoco.mj_forward(model, data)
        for contact in data.contact:
            sign = 1.0 if contact.geom[0] == 0 else -1.0
            found[place] = [contact.dist, *contact.pos, *(sign * contact.frame[:3])]
    return found


@pytest.mark.parametrize("kinds", [*CONVEX, *WITH_A_MESH])
def test_convex_geoms_touch_as_in_mujoco(kinds: tuple[str, str]) -> None:
    """Distances to 2e-5 m; most normals to 2e-3, and positions to 1e-4 m.

    Some deep edges of boxes and meshes have another direction of less overlap than the one that is found.
    """
    given = states(kinds)
    ours, theirs = given.deepest(), of_mujoco(given)
    both = ~np.isnan(theirs[:, 0])
    assert both.sum() > 0.8 * NUM_STATES
    assert np.all(ours[~both, 0] > MARGIN - 2e-5)
    apart = np.abs(ours - theirs)[both]
    assert np.quantile(apart[:, 0], 0.97 if kinds == ("box", "mesh") else 1.0) < 2e-5
    assert np.quantile(apart[:, 4:].max(axis=1), 0.95) < 2e-3
    assert np.quantile(apart[:, 1:4].max(axis=1), 0.8) < 1e-4


@pytest.mark.parametrize("kinds", [("cylinder", "cylinder"), ("capsule", "mesh")])
def test_machine_code_finds_the_same_contacts(kinds: tuple[str, str]) -> None:
    """In single precision."""
    given, program = states(kinds), Program()
    inputs = {"sizes": 6, "positions": 6, "rotations": 18}
    sizes, positions, rotations = (list(program.inputs(name, size)) for name, size in inputs.items())
    geoms = [
        Placed(
            positions[3 * geom :][:3],
            [rotations[9 * geom + 3 * row :][:3] for row in range(3)],
            UNTURNED,
            sizes[3 * geom :][:3],
            given.hull if geom else None,
        )
        for geom in range(2)
    ]
    collide, num_points = COLLIDERS[kind(kinds[0]), kind(kinds[1])]
    program.output(
        "points", [x for one in collide(*geoms) for x in (one.distance, *one.position, *one.normal)]
    )
    values = {name: list(getattr(given, name).reshape(NUM_STATES, -1).T) for name in inputs}
    found = deepest(run(program, values)["points"].T.reshape(NUM_STATES, num_points, 7).astype(float))
    apart = np.abs(found - given.deepest())
    assert np.max(apart[:, 0]) < 2e-5
    assert np.quantile(apart[:, 4:].max(axis=1), 0.95) < 2e-3


def lying(
    kinds: tuple[str, str], sizes: list[list[float]], position: list[float], turn: Array
) -> list[Touch]:
    """The points of the first of two geoms, on the second one at the origin."""
    one = Placed(position, turn.tolist(), UNTURNED, sizes[0])
    other = Placed([0.0, 0.0, 0.0], UNTURNED, UNTURNED, sizes[1])
    found = COLLIDERS[kind(kinds[0]), kind(kinds[1])][0](one, other)
    return [touch for touch in found if touch.distance < 0.5 * AWAY]


def about_y(angle: float) -> Array:
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])


CYLINDER = [0.1, 0.2, 0.0]


@pytest.mark.parametrize(
    ("kinds", "sizes", "height", "turn", "reach"),
    [
        # A capsule as long as the end is wide, and a small box.
        (("capsule", "cylinder"), [[0.05, 0.4, 0.0], [0.3, 0.1, 0.0]], 0.149, about_y(0.5 * np.pi), 0.3),
        (("cylinder", "cylinder"), [CYLINDER, [0.3, 0.1, 0.0]], 0.299, np.eye(3), 0.1),
    ],
)
def test_geoms_lie_on_a_cylinder_s_end_with_several_points(
    kinds: tuple[str, str], sizes: list[list[float]], height: float, turn: Array, reach: float
) -> None:
    found = [one for one in lying(kinds, sizes, [0.0, 0.0, height], turn) if one.distance < 0.0]
    assert len(found) >= 2
    np.testing.assert_allclose([one.distance for one in found], -0.001, atol=1e-9)
    places = np.array([one.position for one in found])
    np.testing.assert_allclose(np.linalg.norm(places[:, :2], axis=1), reach, atol=1e-6)
    assert np.ptp(places[:, 0]) > 1.2 * reach


ON_A_PLANE = """
<mujoco>
  <asset><mesh name="roof" vertex="0 0 0 0.3 0 0 0.3 0.2 0 0 0.2 0 0 0.1 0.1 0.2 0.1 0.15"/></asset>
  <worldbody>
    <geom type="plane" size="5 5 1" margin="0.01"/>
    <body><freejoint/><geom type="mesh" mesh="roof"/></body>
  </worldbody>
</mujoco>
"""


def test_a_mesh_lies_on_a_plane_with_the_corners_of_a_face_as_in_mujoco() -> None:
    """Its faces have three corners, or four. It is up to 0.01 m deep, or as far away."""
    model, generator, numbers = (
        mujoco.MjModel.from_xml_string(ON_A_PLANE),
        np.random.default_rng(0),
        set[int](),
    )
    hull, plane = read_hull(model, 1), Placed([0.0] * 3, UNTURNED, UNTURNED, [0.0] * 3)
    for _ in range(NUM_STATES):
        data, turn = mujoco.MjData(model), generator.normal(size=4)
        # Half of them lie on a face but for 0.01 rad or so.
        data.qpos[3:] = turn if generator.uniform() < 0.5 else np.eye(4)[generator.integers(2)] + 0.005 * turn
        mujoco.mj_normalizeQuat(model, data.qpos)
        mujoco.mj_kinematics(model, data)
        corners = data.geom_xmat[1].reshape(3, 3) @ model.mesh_vert.T
        data.qpos[2] = -(data.geom_xpos[1][2] + corners[2].min()) + generator.uniform(-0.01, 0.01)
        mujoco.mj_forward(model, data)
        mesh = Placed(
            data.geom_xpos[1].tolist(), data.geom_xmat[1].reshape(3, 3).tolist(), UNTURNED, [0.0] * 3, hull
        )
        found = [numbers_of(one) for one in plane_mesh(plane, mesh) if one.distance < 0.01]
        expected = [[one.dist, *one.pos, *one.frame[:3]] for one in data.contact]
        np.testing.assert_allclose(sorted(found), sorted(expected), atol=1e-7)
        numbers.add(len(found))
    assert numbers == {1, 2, 3, 4}


def numbers_of(touch: Touch) -> list[float]:
    return [float(x) for x in (touch.distance, *touch.position, *touch.normal)]
