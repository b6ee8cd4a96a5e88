"""MuJoCo's skins as glTF's: surfaces whose points follow several bodies."""

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from core.rendering.replay.glb import Glb
from core.rendering.replay.materials import Materials
from core.rendering.replay.shapes import Floats

# glTF's viewers support so many; the weights of a point's further bones go to its heaviest.
_BONES_PER_POINT = 4


def add_skins(glb: Glb, materials: Materials, model: mujoco.MjModel, bodies: list[int]) -> list[int]:
    """Add every skin that is seen; returns their nodes. bodies: the node of each body."""
    return [
        _add_skin(glb, materials, model, skin, bodies)
        for skin in range(model.nskin)
        if model.skin_group[skin] < 3 and model.skin_rgba[skin, 3] > 0
    ]


def _add_skin(glb: Glb, materials: Materials, model: mujoco.MjModel, skin: int, bodies: list[int]) -> int:
    start, number = int(model.skin_vertadr[skin]), int(model.skin_vertnum[skin])
    vertices = model.skin_vert[start : start + number]
    first, num_faces = int(model.skin_faceadr[skin]), int(model.skin_facenum[skin])
    faces = model.skin_face[first : first + num_faces]
    bones = slice(int(model.skin_boneadr[skin]), int(model.skin_boneadr[skin] + model.skin_bonenum[skin]))
    joints, weights = heaviest(_weights(model, bones, number))
    attributes = {
        "POSITION": glb.add_vertices(vertices.astype(np.float32)),
        "NORMAL": glb.add_vertices(_normals(vertices, faces).astype(np.float32)),
        "JOINTS_0": glb.add_vertices(joints),
        "WEIGHTS_0": glb.add_vertices(weights),
    }
    texcoord, material = int(model.skin_texcoordadr[skin]), int(model.skin_matid[skin])
    has_texture = texcoord >= 0 and materials.texture_of(material) is not None
    if has_texture:
        uv = model.skin_texcoord[texcoord : texcoord + number]
        attributes["TEXCOORD_0"] = glb.add_vertices(uv.astype(np.float32))
    look = materials.add(np.array(model.skin_rgba[skin], float), material, with_texture=has_texture)
    surface: dict[str, Any] = {"attributes": attributes, "indices": glb.add_indices(faces), "material": look}
    mesh = glb.add("meshes", primitives=[surface])
    binds = glb.add_array(_inverse_binds(model, bones))
    followed = [bodies[int(body)] for body in model.skin_bonebodyid[bones]]
    own = glb.add("skins", joints=followed, inverseBindMatrices=binds)
    return glb.add("nodes", name=f"skin_{skin}", mesh=mesh, skin=own)


def heaviest(weights: Floats) -> tuple[NDArray[np.uint16], NDArray[np.float32]]:
    """The four heaviest bones of each point [V, 4] and their weights [V, 4], scaled to a sum of one.

    weights: [V, bones].
    """
    padded = np.pad(weights, ((0, 0), (0, max(0, _BONES_PER_POINT - weights.shape[1]))))
    joints = np.argsort(-padded, axis=1, kind="stable")[:, :_BONES_PER_POINT]
    chosen = np.take_along_axis(padded, joints, axis=1)
    chosen = chosen / np.maximum(chosen.sum(axis=1, keepdims=True), 1e-12)
    joints = np.where(chosen > 0, joints, 0)  # As the standard wants it of an unused one.
    return joints.astype(np.uint16), chosen.astype(np.float32)


def _weights(model: mujoco.MjModel, bones: slice, num_vertices: int) -> NDArray[np.float32]:
    """[V, bones], zero where a bone does not move a point."""
    weights = np.zeros((num_vertices, bones.stop - bones.start), np.float32)
    for column, bone in enumerate(range(bones.start, bones.stop)):
        own = slice(model.skin_bonevertadr[bone], model.skin_bonevertadr[bone] + model.skin_bonevertnum[bone])
        weights[model.skin_bonevertid[own], column] = model.skin_bonevertweight[own]
    return weights


def _inverse_binds(model: mujoco.MjModel, bones: slice) -> NDArray[np.float32]:
    """From the skin's frame to that of each bone, as glTF has matrices: [bones, 4, 4], by columns."""
    matrices = np.zeros((bones.stop - bones.start, 4, 4))
    rotation = np.zeros(9)
    for row, bone in enumerate(range(bones.start, bones.stop)):
        mujoco.mju_quat2Mat(rotation, np.array(model.skin_bonebindquat[bone], float))
        inverse = rotation.reshape(3, 3).T
        matrices[row, :3, :3] = inverse
        matrices[row, :3, 3] = -inverse @ model.skin_bonebindpos[bone]
        matrices[row, 3, 3] = 1
    return matrices.transpose(0, 2, 1).astype(np.float32)


def _normals(vertices: Floats, faces: NDArray[Any]) -> Floats:
    """[V, 3]: the mean of the normals of a point's triangles, by their areas."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    of_faces = np.cross(b - a, c - a)
    normals = np.zeros((len(vertices), 3))
    for corner in range(3):
        np.add.at(normals, faces[:, corner], of_faces)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
