"""Meshes by their convex hulls, as MuJoCo has them: the vertices, and the faces as polygons.

A hull is a table of the model. Where a program is written, what looks for its farthest vertex or its lowest
face is a loop over the rows.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import mujoco
import numpy as np
from numpy.typing import NDArray

from mujoco_compiled.program.arithmetic import Number, Vector, dot, maximum, select
from mujoco_compiled.program.memory import column, for_each
from mujoco_compiled.program.program import Symbol

# Each is looked at in every step of a search. A hull with more is made simpler.
MOST_VERTICES = 256
# Vertices that are added at once to a simpler hull: those that are farthest beyond a face.
_AT_ONCE = 16
_LOWEST = -1e9
# Of a hull's size. Vertices whose heights differ less are equally low: rounding may differ between rows.
_SAME_HEIGHT = 1e-6
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Hull:
    """In its geom's frame. vertices: [3] in m. size: the largest coordinate, in m.

    faces: rows of 16 numbers, see `_face_rows`. error: how far the mesh's own hull reaches beyond, in m.
    """

    mesh: int
    vertices: tuple[tuple[float, ...], ...]
    faces: tuple[tuple[float, ...], ...]
    size: float
    error: float

    def farthest(self, direction: Vector) -> Vector:
        """The vertex that is farthest in a direction [3]."""

        def look(vertex: Vector, carried: Vector) -> Vector:
            reach = dot(vertex, direction)
            is_farther = carried[0] < reach
            return [select(is_farther, x, y) for x, y in zip([reach, *vertex], carried, strict=True)]

        return self._over("vertices", self.vertices, look, [_LOWEST, 0.0, 0.0, 0.0], direction)[1:]

    def lowest_face(self, downwards: Vector) -> tuple[list[Vector], Number]:
        """Four vertices of the face about the farthest vertex in a direction [3] of length 1 whose normal is
        nearest to it; and whether there are four, or three and one of them twice.

        Where the face has more, they are spread around it, the farthest among them.
        """

        def look(row: Vector, carried: Vector) -> Vector:
            corners, normal, kind = _parted(row[:12]), row[12:15], row[15]
            heights = [dot(corner, downwards) for corner in corners]
            others = maximum(maximum(heights[1], heights[2]), heights[3])
            height = select(kind < 1.5, maximum(heights[0], others), heights[0])
            cosine = dot(normal, downwards)
            farther = height - carried[0]
            among_equals = select(farther > -self._close, select(carried[1] < cosine, 1.0, 0.0), 0.0)
            is_better = select(farther > self._close, 1.0, among_equals) > 0.5
            found = [cosine, *row[:12], kind]
            chosen = [select(is_better, x, y) for x, y in zip(found, carried[1:], strict=True)]
            return [maximum(height, carried[0]), *chosen]

        found = self._over("faces", self.faces, look, [_LOWEST] * 2 + [0.0] * 13, downwards)[2:]
        return _parted(found[:12]), found[12] > 0.5

    @property
    def _close(self) -> float:
        return _SAME_HEIGHT * self.size

    def _over(
        self,
        name: str,
        rows: Sequence[Sequence[float]],
        look: Callable[[Vector, Vector], Vector],
        carried: Vector,
        direction: Vector,
    ) -> Vector:
        """The carried numbers after a look at each row. direction: by which a program is known."""
        symbol = next((x for x in direction if isinstance(x, Symbol)), None)
        if symbol is None:
            for row in rows:
                carried = look(list(row), carried)
            return carried
        columns = [
            column(symbol.program, f"mesh {self.mesh} {name} {place}", values)
            for place, values in enumerate(zip(*rows, strict=True))
        ]
        return for_each(
            symbol.program,
            len(rows),
            lambda row, before: look([own.at(row) for own in columns], before),
            carried,
        )


def read_hull(model: mujoco.MjModel, geom: int) -> Hull | None:
    """The hull of a geom that is a mesh."""
    if model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_MESH:
        return None
    mesh = int(model.geom_dataid[geom])
    vertices, faces = _hull(model, mesh)
    error = 0.0
    if len(vertices) > MOST_VERTICES:
        vertices, faces, error = _simpler(vertices.tobytes())
    rows = tuple(row for face in faces for row in _face_rows(*face))
    return Hull(mesh, _tuples(vertices), _tuples(rows), float(np.abs(vertices).max()), error)


# Of each face: the vertices [n, 3] in order around it, and the normal [3].
Faces = list[tuple[Array, Array]]


def _hull(model: mujoco.MjModel, mesh: int) -> tuple[Array, Faces]:
    """Vertices [n, 3], and the faces."""
    begin, end = (int(model.mesh_vertadr[mesh]) + k * int(model.mesh_vertnum[mesh]) for k in (0, 1))
    vertices = np.asarray(model.mesh_vert[begin:end], float)
    faces: Faces = []
    first, num = int(model.mesh_polyadr[mesh]), int(model.mesh_polynum[mesh])
    for face in range(first, first + num):
        at, size = int(model.mesh_polyvertadr[face]), int(model.mesh_polyvertnum[face])
        own = vertices[model.mesh_polyvert[at : at + size]]
        faces.append((own, np.asarray(model.mesh_polynormal[face], float)))
    graph = model.mesh_graph[int(model.mesh_graphadr[mesh]) :]
    return vertices[graph[2 + graph[0] : 2 + 2 * graph[0]]], faces


@lru_cache(maxsize=64)
def _simpler(whole: bytes) -> tuple[Array, Faces, float]:
    """A hull of as many of the vertices as there may be, and how far others are beyond it, in m."""
    vertices = np.frombuffer(whole).reshape(-1, 3)
    chosen = np.unique([*vertices.argmin(axis=0), *vertices.argmax(axis=0)])
    if len(chosen) < 4:
        chosen = np.unique([*chosen, *range(4)])
    while True:
        found, faces = _hull_of(vertices[chosen])
        beyond = np.array([(vertices - own[0]) @ normal for own, normal in faces])
        left = min(_AT_ONCE, MOST_VERTICES - len(chosen))
        farthest = beyond.argmax(axis=1)[np.argsort(-beyond.max(axis=1))]
        more = [one for one in dict.fromkeys(farthest.tolist()) if one not in chosen][:left]
        # None is left where all others are within rounding of the hull.
        if not more:
            return found, faces, max(0.0, float(beyond.max()))
        chosen = np.union1d(chosen, more)


def _hull_of(vertices: Array) -> tuple[Array, Faces]:
    """As MuJoCo's compiler finds it."""
    spec = mujoco.MjSpec()
    spec.add_mesh(name="hull", uservert=vertices.ravel(), inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX)
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="hull")
    model = spec.compile()
    # The compiler has moved the mesh to its centre of mass and turned it to its principal axes.
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.mesh_quat[0])
    turn, middle, (found, faces) = rotation.reshape(3, 3), model.mesh_pos[0], _hull(model, 0)
    return found @ turn.T + middle, [(own @ turn.T + middle, turn @ normal) for own, normal in faces]


def _face_rows(vertices: Array, normal: Array) -> list[list[float]]:
    """Of a face: four vertices, the normal, and a kind: 0 of three vertices (and one again), 1 of four.

    2: of more; such a face has a row for each vertex that can be the farthest, with three others that are far
    apart. MuJoCo takes four, too, but not always these.
    """
    number = len(vertices)
    if number <= 4:
        return [[*np.ravel([*vertices, vertices[-1]][:4]), *normal, float(number - 3)]]
    return [[*np.ravel(_spread(vertices, first, normal)), *normal, 2.0] for first in vertices]


def _spread(vertices: Array, first: Array, normal: Array) -> list[Array]:
    """A vertex [3], the farthest from it, and the farthest from the line between both on either side."""
    second = vertices[np.linalg.norm(vertices - first, axis=1).argmax()]
    aside = (vertices - first) @ np.cross(normal, second - first)
    return [first, second, vertices[aside.argmax()], vertices[aside.argmin()]]


def _parted(numbers: Vector) -> list[Vector]:
    return [numbers[place : place + 3] for place in range(0, len(numbers), 3)]


def _tuples(rows: Sequence[Sequence[float]] | Array) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(x) for x in row) for row in rows)
