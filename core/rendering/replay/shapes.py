"""The surface of each type of geom as triangles, and by what a geom of any size stretches it.

Source: MuJoCo's XML reference, `body/geom`: sizes are half-lengths and radii.
"""

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating[Any]]
_TYPES = mujoco.mjtGeom
_AROUND, _ARC = 20, 6
# A heightfield of more points than this along a side is thinned.
_MOST_POINTS = 256
# The size of a plane without an end; a viewer moves it along with its camera.
ENDLESS_M = 200.0


@dataclass(frozen=True)
class Surface:
    """Triangles. vertices, normals: [V, 3]; faces: [F, 3], counter-clockwise from outside; uv: [V, 2]."""

    vertices: Floats
    normals: Floats
    faces: NDArray[np.integer[Any]]
    uv: Floats | None = None


@dataclass(frozen=True)
class Part:
    """A geom or site of a model. name: of its node; number: of its mesh or heightfield, -1 for others.

    size: [3] as MuJoCo has it. position [3], rotation [4] (w x y z): in the frame of `body`.
    """

    name: str
    kind: mujoco.mjtGeom
    number: int
    size: Floats
    body: int
    position: Floats
    rotation: Floats
    rgba: Floats
    material: int

    @property
    def key(self) -> tuple[Any, ...]:
        """Equal for parts that share a surface."""
        own_size = tuple(self.size[:2].tolist()) if self.kind == _TYPES.mjGEOM_CAPSULE else ()
        return (self.kind.name, self.number, *own_size)

    @property
    def is_endless(self) -> bool:
        return self.kind == _TYPES.mjGEOM_PLANE and not (self.size[:2] > 0).all()

    def scale(self, size: Floats) -> Floats:
        """By what [3] the part's surface is stretched where its size is `size` [3]."""
        match self.kind:
            case _TYPES.mjGEOM_PLANE:
                return np.array([size[0] or ENDLESS_M, size[1] or ENDLESS_M, 1.0])
            case _TYPES.mjGEOM_SPHERE:
                return np.full(3, size[0])
            case _TYPES.mjGEOM_CYLINDER:
                return np.array([size[0], size[0], size[1]])
            case _TYPES.mjGEOM_BOX | _TYPES.mjGEOM_ELLIPSOID:
                return np.array(size)
            case _TYPES.mjGEOM_CAPSULE:
                across = float(size[0] / self.size[0])
                return np.array([across, across, float((size[0] + size[1]) / (self.size[0] + self.size[1]))])
            case _:
                return np.ones(3)


def surface_of(model: mujoco.MjModel, part: Part) -> Surface | None:
    """The surface of a part of scale one; None for a type that has none."""
    match part.kind:
        case _TYPES.mjGEOM_PLANE:
            return _square()
        case _TYPES.mjGEOM_SPHERE | _TYPES.mjGEOM_ELLIPSOID:
            return _capsule(1.0, 0.0)
        case _TYPES.mjGEOM_CAPSULE:
            return _capsule(float(part.size[0]), float(part.size[1]))
        case _TYPES.mjGEOM_CYLINDER:
            return _cylinder()
        case _TYPES.mjGEOM_BOX:
            return _box()
        case _TYPES.mjGEOM_MESH | _TYPES.mjGEOM_SDF:
            return _mesh(model, part.number)
        case _TYPES.mjGEOM_HFIELD:
            return _heightfield(model, part.number)
        case _:
            return None


def _square() -> Surface:
    vertices = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    return Surface(
        vertices, np.tile([0.0, 0.0, 1.0], (4, 1)), np.array([[0, 1, 2], [0, 2, 3]]), vertices[:, :2]
    )


def _box() -> Surface:
    corners = np.array([[1, -1, -1], [1, 1, -1], [1, 1, 1], [1, -1, 1]], float)  # the side x = 1
    sides = [(np.roll(corners * sign, turn, axis=1), sign) for turn in range(3) for sign in (1, -1)]
    # Mirrored at the origin a square keeps its sense of rotation about the normal, which also turns round.
    faces = [np.array([[0, 1, 2], [0, 2, 3]])[:, ::sign] + 4 * n for n, (_, sign) in enumerate(sides)]
    normals = [np.tile(np.roll([sign, 0, 0], n // 2), (4, 1)) for n, (_, sign) in enumerate(sides)]
    return Surface(
        np.concatenate([side for side, _ in sides]),
        np.concatenate(normals).astype(float),
        np.concatenate(faces),
    )


def _capsule(radius: float, half: float) -> Surface:
    """A capsule about z of the half-length `half`; a sphere if that is 0."""
    down = np.linspace(0, np.pi / 2, _ARC + 1)
    angles = np.concatenate([down, np.pi / 2 + down if half else np.pi / 2 + down[1:]])
    normals = np.stack([np.sin(angles), np.cos(angles)], axis=1)
    lift = np.where(np.arange(len(angles)) <= _ARC, half, -half)
    return _revolved(radius * normals + np.stack([np.zeros_like(lift), lift], axis=1), normals)


def _cylinder() -> Surface:
    profile = np.array([[0, 1], [1, 1], [1, 1], [1, -1], [1, -1], [0, -1]], float)
    return _revolved(profile, np.array([[0, 1], [0, 1], [1, 0], [1, 0], [0, -1], [0, -1]], float))


def _revolved(profile: Floats, normals: Floats) -> Surface:
    """The surface that a profile [P, (distance from z, z)], from top to bottom, makes about z."""
    turns = np.linspace(0, 2 * np.pi, _AROUND + 1)

    def around(rows: Floats) -> Floats:
        points = [
            rows[:, :1] * np.cos(turns),
            rows[:, :1] * np.sin(turns),
            np.repeat(rows[:, 1:], len(turns), 1),
        ]
        return np.stack(points, axis=-1).reshape(-1, 3)

    row, column = np.meshgrid(np.arange(len(profile) - 1), np.arange(_AROUND), indexing="ij")
    first = (row * len(turns) + column).ravel()
    below = first + len(turns)
    faces = np.concatenate(
        [np.stack([first, below, below + 1], axis=1), np.stack([first, below + 1, first + 1], axis=1)]
    )
    vertices = around(profile)
    corners = vertices[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return Surface(vertices, around(normals), faces[area > 1e-12 * area.max()])


def _mesh(model: mujoco.MjModel, mesh: int) -> Surface:
    """A mesh as the model keeps it: scaled, and about its own centre."""
    faces = _part(model.mesh_face, model.mesh_faceadr[mesh], model.mesh_facenum[mesh])
    corners = [faces.ravel(), _part(model.mesh_facenormal, model.mesh_faceadr[mesh], len(faces)).ravel()]
    has_uv = model.mesh_texcoordadr[mesh] >= 0
    if has_uv:
        corners.append(_part(model.mesh_facetexcoord, model.mesh_faceadr[mesh], len(faces)).ravel())
    unique, index = np.unique(np.stack(corners, axis=1), axis=0, return_inverse=True)
    uv = model.mesh_texcoord[model.mesh_texcoordadr[mesh] + unique[:, 2]] if has_uv else None
    return Surface(
        model.mesh_vert[model.mesh_vertadr[mesh] + unique[:, 0]],
        model.mesh_normal[model.mesh_normaladr[mesh] + unique[:, 1]],
        index.reshape(-1, 3),
        uv,
    )


def _part(values: NDArray[Any], start: int, number: int) -> NDArray[Any]:
    return values[int(start) : int(start) + int(number)]


def _heightfield(model: mujoco.MjModel, field: int) -> Surface:
    rows, columns = int(model.hfield_nrow[field]), int(model.hfield_ncol[field])
    heights = _part(model.hfield_data, model.hfield_adr[field], rows * columns).reshape(rows, columns)
    stride = max(1, -(-max(rows, columns) // _MOST_POINTS))
    across, along, top, _ = model.hfield_size[field]
    x = np.linspace(-across, across, columns)[::stride]
    y = np.linspace(-along, along, rows)[::stride]
    z = float(top) * heights[::stride, ::stride]
    dz_dy, dz_dx = np.gradient(z, y, x)
    normals = np.stack([-dz_dx, -dz_dy, np.ones_like(z)], axis=-1).reshape(-1, 3)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    row, column = np.meshgrid(np.arange(len(y) - 1), np.arange(len(x) - 1), indexing="ij")
    first = (row * len(x) + column).ravel()
    above = first + len(x)
    faces = np.concatenate(
        [np.stack([first, first + 1, above + 1], axis=1), np.stack([first, above + 1, above], axis=1)]
    )
    xs, ys = np.meshgrid(x, y)
    vertices = np.stack([xs, ys, z], axis=-1).reshape(-1, 3)
    return Surface(vertices, normals, faces, vertices[:, :2] / np.array([across, along]))
