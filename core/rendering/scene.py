"""How a model is shown: the place of the following camera, the light, the colours of a plain stage.

Everything here changes a model that is only drawn; physics steps another copy.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from core.rendering import floor

# Geoms and sites of higher groups are not drawn: MuJoCo's default.
SHOWN_GROUPS = 3
Floats = NDArray[np.float64]

# The name of the body that marks an episode's target in a model.
TARGET_BODY = "target"
# Names that the software drivers of Mesa and Chromium report.
_SOFTWARE = ("llvmpipe", "softpipe", "swrast", "swiftshader")
_FLOOR_COLOURS = (floor.DARK, floor.LIGHT)
# Translucent, so that a body that has reached it is still seen. Its size is a share of the body's.
TARGET_COLOUR, TARGET_SHARE = (0.86, 0.24, 0.18, 0.7), 0.07
# Sizes of what is drawn besides the body, as shares of the body's: long enough to stick out of it.
_JOINT_LENGTH, _JOINT_WIDTH, _CONTACT_WIDTH, _CONTACT_HEIGHT, _CENTRE = 0.3, 0.03, 0.07, 0.015, 0.06
SKY_COLOURS = ((0.80, 0.88, 0.96), (0.36, 0.54, 0.78))


@dataclass(frozen=True)
class Quality:
    """A picture's cost. samples: per pixel, for smooth edges; shadow_pixels: the shadow map's side."""

    samples: int
    shadow_pixels: int


def quality_of(gl_renderer: str) -> Quality:
    """The best quality on a GPU; in software, where smooth edges double the time, what 30 fps allow."""
    in_software = any(name in gl_renderer.lower() for name in _SOFTWARE)
    return Quality(samples=0, shadow_pixels=1536) if in_software else Quality(samples=4, shadow_pixels=4096)


@dataclass(frozen=True)
class CameraView:
    """Where the camera `track` stands. azimuth, elevation: degrees; distance, radius: metres.

    body: the body that it follows; None if the body cannot leave its place, and the camera looks at `centre`.
    floor: height in metres of a floor that is drawn because the model has none; None to draw none.
    top: how far above the body there is room for what is drawn over its tree, in metres.
    """

    azimuth: float
    elevation: float
    distance: float
    radius: float
    centre: Floats
    body: int | None
    floor: float | None
    top: float


def following_view(model: mujoco.MjModel, qpos: Floats, body: int) -> CameraView:
    """A view of the body's whole kinematic tree at the positions `qpos` [nq].

    A body that turns freely is seen from behind its right side, one in a vertical plane from its side, and
    one that turns only about vertical axes from above.
    """
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    root = int(model.body_rootid[body])
    travels = _travels(model, root)
    # A body that is bolted down swings about its base.
    centre = np.array(data.subtree_com[root] if travels else data.xpos[root])
    radius = _radius(model, data, root, centre)
    azimuth, elevation = _angles(model, root)
    ground = floor.floor_below(model, root, centre, radius)
    # No more than a picture shows above the body.
    top = min(_highest(model, data, root) - float(data.xpos[body, 2]), radius)
    return CameraView(
        azimuth, elevation, 3.4 * radius, radius, centre, body if travels else None, ground, top
    )


def prepare(model: mujoco.MjModel, view: CameraView, quality: Quality, *, width: int, height: int) -> None:
    """Fit buffers and shadows to the picture, and give the stock grey stage a friendlier look."""
    model.vis.global_.offwidth = width
    model.vis.global_.offheight = height
    model.vis.quality.offsamples = quality.samples
    model.vis.quality.shadowsize = quality.shadow_pixels
    # The shadow map covers the body's surroundings, not the whole floor: few pixels, sharp edges. If it were
    # much narrower, the floor in the foreground would shadow itself in specks.
    model.vis.map.shadowclip = 5.0 * view.radius / model.stat.extent
    _size_overlays(model, view.radius)
    floor.without_end(model)
    _light(model)
    _show_undrawn(model)
    _recolour(model)
    _mark_target(model, TARGET_SHARE * view.radius)


def _show_undrawn(model: mujoco.MjModel) -> None:
    """Show the collision geoms of a robot that has few others: its drawings were left out of the file."""
    own = model.geom_bodyid > 0
    is_hidden = (model.geom_group >= SHOWN_GROUPS) | (model.geom_rgba[:, 3] == 0)
    bodies, drawn = (len(set(model.geom_bodyid[some])) for some in (own, own & ~is_hidden))
    if 2 * drawn < bodies:
        model.geom_group[own] = 0


def _travels(model: mujoco.MjModel, root: int) -> bool:
    first = int(model.body_jntadr[root])
    kinds = model.jnt_type[first : first + int(model.body_jntnum[root])]
    return bool(np.isin(kinds, [mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_SLIDE]).any())


def _angles(model: mujoco.MjModel, root: int) -> tuple[float, float]:
    joints = np.flatnonzero(model.body_rootid[model.jnt_bodyid] == root)
    kinds = model.jnt_type[joints]
    if np.isin(kinds, [mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_BALL]).any():
        return 62.0, -20.0
    hinges = model.jnt_axis[joints][kinds == mujoco.mjtJoint.mjJNT_HINGE]
    if len(hinges) and np.abs(hinges[:, 2]).min() > 0.99:
        return 90.0, -75.0
    return 90.0, -10.0


def _radius(model: mujoco.MjModel, data: mujoco.MjData, root: int, centre: Floats) -> float:
    own = (model.body_rootid[model.geom_bodyid] == root) & (model.geom_rbound > 0)
    if not own.any():
        return float(model.stat.extent)
    reach = np.linalg.norm(data.geom_xpos[own] - centre, axis=1) + model.geom_rbound[own]
    return float(reach.max())


def _highest(model: mujoco.MjModel, data: mujoco.MjData, root: int) -> float:
    """The height of the tree's highest point, as boxes around its geoms have it."""
    own = np.flatnonzero((model.body_rootid[model.geom_bodyid] == root) & (model.geom_rgba[:, 3] > 0))
    turns = data.geom_xmat[own].reshape(-1, 3, 3)[:, 2]
    boxes = model.geom_aabb[own].reshape(-1, 2, 3)
    tops = data.geom_xpos[own, 2] + (turns * boxes[:, 0] + np.abs(turns) * boxes[:, 1]).sum(axis=1)
    return float(tops.max(initial=data.xpos[root, 2]))


def _size_overlays(model: mujoco.MjModel, radius: float) -> None:
    """MuJoCo sizes them by the model's mean size, in which a large arena or tiny parts weigh as well: make
    them no smaller than shares of the body."""
    scale, unit = model.vis.scale, radius / model.stat.meansize
    scale.jointlength = max(scale.jointlength, _JOINT_LENGTH * unit)
    scale.jointwidth = max(scale.jointwidth, _JOINT_WIDTH * unit)
    scale.contactwidth = max(scale.contactwidth, _CONTACT_WIDTH * unit)
    scale.contactheight = max(scale.contactheight, _CONTACT_HEIGHT * unit)
    scale.com = max(scale.com, _CENTRE * unit)


def _light(model: mujoco.MjModel) -> None:
    """A light straight overhead flattens everything: make it a low sun, and let the head light fill in."""
    model.mat_reflectance[:] = 0.0  # A mirror costs a second pass and hides the checker.
    overhead = model.light_dir[:, 2] < -0.999
    direction = np.array([0.35, 0.35, -1.0]) / np.linalg.norm([0.35, 0.35, -1.0])
    model.light_dir[overhead] = model.light_dir0[overhead] = direction  # dir0: if it tracks a body
    model.light_type[overhead] = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    if not model.light_castshadow.any():
        model.light_castshadow[overhead] = 1  # Without a shadow a foot on the ground looks like one above it.
    model.vis.headlight.ambient[:] = 0.35
    model.vis.headlight.diffuse[:] = 0.35
    model.vis.headlight.specular[:] = 0.1


def _recolour(model: mujoco.MjModel) -> None:
    """Recolour a stock grey floor and a black sky in blue-grey; other textures stay."""
    for texture in range(model.ntex):
        pixels = _pixels(model, texture)
        flat = pixels.reshape(-1, pixels.shape[-1])
        if pixels.shape[-1] != 3:
            continue
        if model.tex_type[texture] == mujoco.mjtTexture.mjTEXTURE_SKYBOX and flat.min(axis=0).max() < 8:
            _remap(flat, *SKY_COLOURS)
        elif model.tex_type[texture] == mujoco.mjtTexture.mjTEXTURE_2D and _is_grey_checker(flat):
            _remap(flat, *_FLOOR_COLOURS)
            _undim(model, texture)
    white = (model.geom_rgba[:, :3] > 0.99).all(axis=1) & (model.geom_matid < 0)
    model.geom_rgba[white & (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE), :3] = floor.LIGHT


def _mark_target(model: mujoco.MjModel, radius: float) -> None:
    """Colour a target that looks like a part of the body, and draw it large enough to be seen."""
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, TARGET_BODY)
    plain = (model.geom_matid < 0) & (model.geom_rgba[:, 3] > 0)
    own = plain & (model.geom_bodyid == body)
    others = model.geom_rgba[plain & ~own]
    for geom in np.flatnonzero(own & (model.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE)):
        if (others == model.geom_rgba[geom]).all(axis=1).any():
            model.geom_rgba[geom] = TARGET_COLOUR
            model.geom_size[geom, 0] = max(model.geom_size[geom, 0], radius)


def _pixels(model: mujoco.MjModel, texture: int) -> NDArray[np.uint8]:
    start, channels = int(model.tex_adr[texture]), int(model.tex_nchannel[texture])
    size = int(model.tex_height[texture]) * int(model.tex_width[texture])
    return model.tex_data[start : start + size * channels].reshape(size, channels)


def _is_grey_checker(flat: NDArray[np.uint8]) -> bool:
    colours = np.unique(flat, axis=0)
    return len(colours) == 2 and bool((colours == colours[:, :1]).all())


def _remap(flat: NDArray[np.uint8], dark: tuple[float, ...], light: tuple[float, ...]) -> None:
    grey = flat.mean(axis=1, keepdims=True)
    share = (grey - grey.min()) / max(float(np.ptp(grey)), 1.0)
    flat[:] = np.round(255 * (np.array(dark) * (1 - share) + np.array(light) * share))


def _undim(model: mujoco.MjModel, texture: int) -> None:
    """Show the texture in its own colours, without gloss, on all geoms and materials that have it."""
    materials = np.flatnonzero((model.mat_texid == texture).any(axis=1))
    model.mat_rgba[materials, :3] = 1.0
    model.mat_specular[materials] = 0.1
    model.geom_rgba[np.isin(model.geom_matid, materials), :3] = 1.0
