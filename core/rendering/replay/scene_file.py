"""A model's geometry as binary glTF: what a browser draws, and what other programs can open.

A node `world` turns MuJoCo's axes (z up) to glTF's (y up). Below it is a node for each body, `body_<i>`, at
its pose in the model's initial positions, and below that a node for each geom or site that is seen,
`geom_<i>` or `site_<i>`, in its body's frame. Skins follow their bodies.
"""

from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from core.rendering import floor
from core.rendering.replay.glb import Glb
from core.rendering.replay.materials import Materials
from core.rendering.replay.shapes import ENDLESS_M, Floats, Part, Surface, surface_of
from core.rendering.replay.skins import add_skins
from core.rendering.scene import SHOWN_GROUPS, CameraView

# A geom of this colour has that of its material.
_UNSET = (0.5, 0.5, 0.5, 1.0)


def parts(model: mujoco.MjModel) -> Iterator[Part]:
    """The geoms, then the sites; the node of geom 3 is named `geom_3`."""
    for geom in range(model.ngeom):
        rgba = _colour(model, model.geom_rgba[geom], int(model.geom_matid[geom]))
        if model.geom_group[geom] < SHOWN_GROUPS and rgba[3] > 0:
            yield Part(
                f"geom_{geom}",
                mujoco.mjtGeom(int(model.geom_type[geom])),
                int(model.geom_dataid[geom]),
                np.array(model.geom_size[geom]),
                int(model.geom_bodyid[geom]),
                np.array(model.geom_pos[geom]),
                np.array(model.geom_quat[geom]),
                rgba,
                int(model.geom_matid[geom]),
            )
    for site in range(model.nsite):
        rgba = _colour(model, model.site_rgba[site], int(model.site_matid[site]))
        if model.site_group[site] < SHOWN_GROUPS and rgba[3] > 0:
            yield Part(
                f"site_{site}",
                mujoco.mjtGeom(int(model.site_type[site])),
                -1,
                np.array(model.site_size[site]),
                int(model.site_bodyid[site]),
                np.array(model.site_pos[site]),
                np.array(model.site_quat[site]),
                rgba,
                int(model.site_matid[site]),
            )


def _colour(model: mujoco.MjModel, own: Floats, material: int) -> Floats:
    """[4]: its own colour; its material's where it has not been given one."""
    if material >= 0 and np.allclose(own, _UNSET):
        return np.array(model.mat_rgba[material], float)
    return np.array(own, float)


_Z_UP = [-(0.5**0.5), 0.0, 0.0, 0.5**0.5]  # -90 degrees about x; x y z w


def scene_bytes(model: mujoco.MjModel, view: CameraView) -> bytes:
    """The file. model: as `core.rendering.scene.prepare` left it; view: has the height of a floor."""
    glb = Glb()
    materials = Materials(model, glb)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    bodies = [
        glb.add(
            "nodes",
            name=f"body_{body}",
            translation=data.xpos[body].tolist(),
            rotation=xyzw(data.xquat[body]),
            extras={"name": str(model.body(body).name)},
        )
        for body in range(model.nbody)
    ]
    children: dict[int, list[int]] = {}
    meshes: dict[tuple[Any, ...], int] = {}
    for part in parts(model):
        node = _add_part(glb, materials, meshes, part)
        if node is not None:
            children.setdefault(part.body, []).append(node)
    if view.floor is not None:
        children.setdefault(0, []).append(_add_floor(glb, materials, view.floor, view.radius))
    for body, nodes in children.items():
        glb.document["nodes"][bodies[body]]["children"] = nodes
    skins = add_skins(glb, materials, model, bodies)
    world = glb.add("nodes", name="world", rotation=_Z_UP, children=bodies)
    glb.add("scenes", nodes=[world, *skins])
    glb.document["scene"] = 0
    return glb.to_bytes()


def xyzw(quaternion: Floats) -> list[float]:
    """glTF's order of MuJoCo's w x y z."""
    return np.roll(quaternion, -1).tolist()


def _add_part(glb: Glb, materials: Materials, meshes: dict[tuple[Any, ...], int], part: Part) -> int | None:
    texture = materials.texture_of(part.material)
    # Laid on as its size says: parts of different sizes cannot share it.
    laid_on = part.name if texture is not None else None
    key = (*part.key, *part.rgba.tolist(), part.material, laid_on)
    if key not in meshes:
        surface = surface_of(materials.model, part)
        if surface is None:
            return None
        uv = None if texture is None else _texture_coordinates(materials.model, part, surface)
        material = materials.add(part.rgba, part.material, with_texture=uv is not None)
        meshes[key] = glb.add("meshes", primitives=[primitive(glb, surface, uv, material)])
    return glb.add(
        "nodes",
        name=part.name,
        mesh=meshes[key],
        translation=part.position.tolist(),
        rotation=xyzw(part.rotation),
        scale=part.scale(part.size).tolist(),
        extras={"endless": _period(materials.model, part)} if part.is_endless else None,
    )


def primitive(glb: Glb, surface: Surface, uv: Floats | None, material: int) -> dict[str, Any]:
    """A glTF primitive of this surface."""
    attributes = {
        "POSITION": glb.add_vertices(surface.vertices.astype(np.float32)),
        "NORMAL": glb.add_vertices(surface.normals.astype(np.float32)),
    }
    if uv is not None:
        attributes["TEXCOORD_0"] = glb.add_vertices(uv.astype(np.float32))
    return {"attributes": attributes, "indices": glb.add_indices(surface.faces), "material": material}


def _texture_coordinates(model: mujoco.MjModel, part: Part, surface: Surface) -> Floats | None:
    """[V, 2], as MuJoCo lays a flat texture on: along the part's x and y; a mesh has its own."""
    if part.kind in (mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_SDF):
        return None if surface.uv is None else surface.uv * model.mat_texrepeat[part.material]
    across = (surface.vertices[:, :2] if surface.uv is None else surface.uv) * [1, -1]
    repeats = 0.5 * model.mat_texrepeat[part.material]
    if part.is_endless:  # A texture's middle is at the origin.
        return repeats * across * part.scale(part.size)[:2] + 0.5
    # A texture begins at the corner of the part.
    uniform = part.scale(part.size)[:2] if model.mat_texuniform[part.material] else 1.0
    return repeats * (across + 1) * uniform


def _period(model: mujoco.MjModel, part: Part) -> list[float]:
    """By multiples of these metres [2] an endless plane may move without anybody seeing it."""
    return (2 / model.mat_texrepeat[part.material]).tolist() if part.material >= 0 else [1.0, 1.0]


def _add_floor(glb: Glb, materials: Materials, height: float, radius: float) -> int:
    """The floor that `core.rendering.floor` draws below a body in the air."""
    side = 0.6 * radius
    material = materials.add_checker(np.array(floor.LIGHT), np.array(floor.DARK))
    half = ENDLESS_M * radius
    corners: NDArray[np.float64] = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float)
    surface = Surface(
        np.pad(corners, ((0, 0), (0, 1))), np.tile([0.0, 0.0, 1.0], (4, 1)), np.array([[0, 1, 2], [0, 2, 3]])
    )
    mesh = glb.add("meshes", primitives=[primitive(glb, surface, corners / (2 * side), material)])
    extras = {"endless": [2 * side, 2 * side]}
    return glb.add("nodes", name="floor", mesh=mesh, translation=[0.0, 0.0, height], extras=extras)
