"""Meshes by their convex hulls, as MuJoCo has them: the vertices, and the faces as polygons.

A hull is a set of tables of the model, of which each environment reads the rows that it needs: `farthest` has
the vertex that is farthest in a direction, and the face that lies lowest is one of those about it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from mujoco_compiled.collisions.farthest import Farthest, farthest_of
from mujoco_compiled.program.arithmetic import Number, Vector, dot, select
from mujoco_compiled.program.flow import repeat
from mujoco_compiled.program.memory import Lookup

_LOWEST = -1e9
Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Hull:
    """In its geom's frame. mesh: its number. vertices: [n, 3] in m. middle, half: [3] in m, of the box about
    it.

    corners, normals, counts: the columns of `_face_rows`. around: rows of the faces about a vertex, one
    vertex after the other; ends: by vertex, where its own begin and end. most_around: of a vertex.
    """

    mesh: int
    vertices: Array
    middle: Vector
    half: Vector
    _farthest: Farthest
    corners: Sequence[Lookup]
    normals: Sequence[Lookup]
    counts: Lookup
    around: Lookup
    ends: tuple[Lookup, Lookup]
    most_around: int

    def farthest(self, direction: Vector) -> Vector:
        """The vertex [3] that is farthest in a direction [3]."""
        return self._farthest.at(direction)[1]

    def lowest_face(self, downwards: Vector) -> tuple[list[Vector], Number]:
        """Four vertices of the face about the farthest vertex in a direction [3] of length 1 whose normal is
        nearest to it; and whether there are four, or three and one of them twice.

        Where the face has more, they are spread around it, the farthest among them.
        """
        vertex = self._farthest.at(downwards)[0]
        begin, end = (one.at(vertex) for one in self.ends)

        def look(carried: list[Number]) -> tuple[list[Number], Number]:
            place, best, cosine = carried
            row = self.around.at(place)
            own = dot([one.at(row) for one in self.normals], downwards)
            is_better = cosine < own
            found = [place + 1.0, select(is_better, row, best), select(is_better, own, cosine)]
            return found, place + 1.0 < end

        row = repeat(self.most_around, look, [begin, 0.0 * begin, 0.0 * begin + _LOWEST])[1]
        numbers = [one.at(row) for one in self.corners]
        return [numbers[place : place + 3] for place in range(0, 12, 3)], self.counts.at(row) > 3.5


def read_hull(model: mujoco.MjModel, geom: int) -> Hull | None:
    """The hull of a geom that is a mesh."""
    if model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_MESH:
        return None
    mesh = int(model.geom_dataid[geom])
    vertices, faces = _read(model, mesh)
    rows, about = list[Array](), [list[int]() for _ in vertices]
    for corners, normal in faces:
        for row, own in _face_rows(vertices, corners, normal):
            for vertex in own:
                about[vertex].append(len(rows))
            rows.append(row)
    ends = np.cumsum([0, *map(len, about)]).astype(float)
    table, name = np.array(rows), f"mesh {mesh}"
    columns = [Lookup(f"{name} faces {place}", values) for place, values in enumerate(table.T)]
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    return Hull(
        mesh=mesh,
        vertices=vertices,
        middle=(0.5 * (low + high)).tolist(),
        half=(0.5 * (high - low)).tolist(),
        _farthest=farthest_of(name, vertices),
        corners=columns[:12],
        normals=columns[12:15],
        counts=columns[15],
        around=Lookup(f"{name} around", np.array([row for own in about for row in own], float)),
        ends=(
            Lookup(f"{name} begins", ends[:-1]),
            Lookup(f"{name} ends", ends[1:]),
        ),
        most_around=max(map(len, about)),
    )


# Of each face: the numbers of its vertices in order around it, and the normal [3].
Faces = list[tuple[list[int], Array]]


def _read(model: mujoco.MjModel, mesh: int) -> tuple[Array, Faces]:
    """Vertices [n, 3], and the faces."""
    begin, end = (int(model.mesh_vertadr[mesh]) + k * int(model.mesh_vertnum[mesh]) for k in (0, 1))
    vertices = np.asarray(model.mesh_vert[begin:end], float)
    graph = model.mesh_graph[int(model.mesh_graphadr[mesh]) :]
    own = graph[2 + graph[0] : 2 + 2 * graph[0]]
    places = {int(vertex): place for place, vertex in enumerate(own)}
    faces: Faces = []
    first, num = int(model.mesh_polyadr[mesh]), int(model.mesh_polynum[mesh])
    for face in range(first, first + num):
        at, size = int(model.mesh_polyvertadr[face]), int(model.mesh_polyvertnum[face])
        corners = [places[int(vertex)] for vertex in model.mesh_polyvert[at : at + size]]
        faces.append((corners, np.asarray(model.mesh_polynormal[face], float)))
    return vertices[own], faces


def _face_rows(vertices: Array, corners: list[int], normal: Array) -> list[tuple[Array, list[int]]]:
    """Rows of a face [16], each with the vertices about which it is looked at: four vertices, the normal, and
    how many there are.

    A face of more than four has a row for each of its vertices, with three others that are far apart. MuJoCo
    takes four, too, but not always these.
    """
    if len(corners) <= 4:
        four = [*corners, corners[-1]][:4]
        return [(np.array([*vertices[four].ravel(), *normal, float(len(corners))]), corners)]
    return [
        (np.array([*np.ravel(_spread(vertices[corners], vertices[first], normal)), *normal, 4.0]), [first])
        for first in corners
    ]


def _spread(vertices: Array, first: Array, normal: Array) -> list[Array]:
    """A vertex [3], the farthest from it, and the farthest from the line between both on either side."""
    second = vertices[np.linalg.norm(vertices - first, axis=1).argmax()]
    aside = (vertices - first) @ np.cross(normal, second - first)
    return [first, second, vertices[aside.argmax()], vertices[aside.argmin()]]
