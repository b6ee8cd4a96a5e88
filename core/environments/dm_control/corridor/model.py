"""The composed corridor, without the parts that cost time."""

from typing import Any

import mujoco
import numpy as np

from core.environments import optional_packages
from core.environments.dm_control.corridor.aesthetics import HIDDEN, draw
from core.environments.dm_control.corridor.info import CorridorOptions
from core.environments.dm_control.corridor.layouts import (
    Boxes,
    Layouts,
    Obstacle,
    draw_layouts,
    is_box,
    obstacles_among,
)
from core.environments.dm_control.corridor.termination import add_contact_sensors
from core.environments.dm_control.corridor.walkers import WALKERS
from core.environments.dm_control.dm_control_import import without_a_display
from core.installation import to_install


def composed(options: CorridorOptions) -> tuple[mujoco.MjSpec, list[float]]:
    """The specification of the walker in its corridor, and where it stands upright.

    The latter is the position and quaternion [7] of the free joint, on the ground plane z = 0. Equal options
    give equal corridors: lengths are drawn from `arena_seed` alone.
    Raises JobFailed("bad_model") where dm_control, which brings both, is not installed.
    """
    with without_a_display():
        arena = _arena(options)
        walker = _named(WALKERS[options.walker].source)()
    arena.regenerate(np.random.RandomState(options.arena_seed))
    start = arena.mjcf_model.worldbody.add("site", size=[1e-6] * 3)
    walker.create_root_joints(arena.attach(walker, attach_site=start))
    pose = walker.upright_pose
    position = np.zeros(3) if pose.xpos is None else np.array(pose.xpos, float)
    position[0] += options.start_x
    quaternion = np.array([1.0, 0, 0, 0] if pose.xquat is None else pose.xquat, float)
    spec = mujoco.MjSpec.from_string(arena.mjcf_model.to_xml_string(), assets=arena.mjcf_model.get_assets())
    return spec, [*position.tolist(), *(quaternion / np.linalg.norm(quaternion)).tolist()]


def _arena(options: CorridorOptions) -> Any:
    corridors = _module("dm_control.locomotion.arenas.corridors")
    uniform = _named("dm_control.composer.variation.distributions:Uniform")
    common = {
        "corridor_width": options.corridor_width,
        "corridor_length": options.corridor_length,
        "visible_side_planes": False,
    }
    match options.arena:
        case "empty":
            return corridors.EmptyCorridor(**common)
        case "gaps":
            return corridors.GapsCorridor(
                platform_length=uniform(*options.platform_length),
                gap_length=uniform(*options.gap_length),
                **common,
            )
        case "walls":
            return corridors.WallsCorridor(
                wall_gap=uniform(*options.wall_gap),
                wall_width=uniform(*options.wall_width),
                wall_height=options.wall_height,
                **common,
            )


def _named(source: str) -> Any:
    module, _, name = source.partition(":")
    return getattr(_module(module), name)


def _module(name: str) -> Any:
    brings, install = "Corridors and their walkers come with dm_control", to_install("dm-control")
    return optional_packages.module(name, brings=brings, install=install)


_SETTLING_S = 3.0
# The extent that a picture shows, in metres: the walker's surroundings, not forty metres of corridor.
_EXTENT_M = 4.0
# Bits of contype (arena) and conaffinity (walker): all parts touch the ground, only the trunk the sides.
_GROUND, _SIDES = 1, 2
# The most that MJX solves for and checks, nearest first; the other engines need no such bound.
_CONTACT_POINTS, _GEOM_PAIRS = 32, 64


def corridor_model(options: CorridorOptions) -> mujoco.MjModel:
    """`corridor_spec` as a model."""
    return corridor_spec(options).compile()


def corridor_spec(options: CorridorOptions) -> mujoco.MjSpec:
    """The walker at the start of its corridor; the numeric `init_qpos` is how it stands there.

    The trunk and all limbs touch the ground, platforms and obstacles; the trunk alone touches the planes
    that bound the corridor; the walker does not touch itself. Friction cones are pyramidal, without noslip
    iterations, which MJX and MuJoCo Warp do not have.
    """
    spec, upright = composed(options)
    info = WALKERS[options.walker]
    spec.option.timestep = options.timestep
    spec.option.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
    spec.option.noslip_iterations = 0
    # The rodent's file reserves 3.4 GB for the contacts of each environment.
    spec.nconmax = spec.njmax = -1
    spec.stat.extent = _EXTENT_M
    for sensor in list(spec.sensors):
        spec.delete(sensor)
    for geom in spec.geoms:
        _filter(geom, info.trunk)
    if options.arena == "gaps":
        _mend_the_ground(spec, options)
    draw(spec, options.aesthetic, squares_per_m=2.0 if info.reach > 0.5 else 10.0)
    _light(spec, info.trunk)
    if options.contact_termination:
        add_contact_sensors(spec, options, ground=_GROUND, sides=_SIDES)
    if any(skin.name for skin in spec.skins):
        # The rodent's skin shows the body, and its geoms would stick out of it.
        for geom in spec.body("walker/").find_all("geom"):
            geom.group = HIDDEN
    spec.add_numeric(name="max_contact_points", data=[_CONTACT_POINTS], size=1)
    spec.add_numeric(name="max_geom_pairs", data=[_GEOM_PAIRS], size=1)
    spec.add_numeric(name="init_qpos", data=_start(spec.compile(), upright, settles=info.settles), size=0)
    return spec


def model_and_layouts(options: CorridorOptions) -> tuple[mujoco.MjModel, Layouts | None]:
    """The walker in a corridor with room for each of the layouts, and these; None: the model's own is the
    only one."""
    if not options.has_layouts:
        return corridor_model(options), None
    layouts = draw_layouts(options)
    return corridor_model(layouts.largest), layouts


def obstacles(model: mujoco.MjModel) -> list[Obstacle]:
    """The gaps or walls in the order of their ends; none in an empty corridor."""
    arena = "walls" if any(geom.name.startswith("wall_") for geom in _box_geoms(model)) else "gaps"
    return obstacles_among(boxes(model), arena)


def boxes(model: mujoco.MjModel) -> Boxes:
    """The platforms or walls [number, 2, 3], as `boxes_of` has them; none in an empty corridor."""
    rows = [[geom.pos, geom.size] for geom in _box_geoms(model)]
    return np.array(rows, float).reshape(-1, 2, 3)


def _box_geoms(model: mujoco.MjModel) -> list[Any]:
    return [geom for geom in map(model.geom, range(model.ngeom)) if is_box(geom.name)]


def _filter(geom: mujoco.MjsGeom, trunk: str) -> None:
    """Set what the geom may touch; one that touches nothing stays so."""
    if not geom.contype and not geom.conaffinity:
        return
    if geom.parent.name.startswith("walker/"):
        geom.contype, geom.conaffinity = 0, _GROUND | (_SIDES if geom.parent.name == trunk else 0)
    else:
        upright = geom.type == mujoco.mjtGeom.mjGEOM_PLANE and geom.group == HIDDEN
        geom.contype, geom.conaffinity = (_SIDES if upright else _GROUND), 0


def _mend_the_ground(spec: mujoco.MjSpec, options: CorridorOptions) -> None:
    """Remove the plane ten metres below the gaps, which nothing reaches, and the hole after the platforms."""
    for geom in list(spec.worldbody.geoms):
        if geom.type == mujoco.mjtGeom.mjGEOM_PLANE and geom.group != HIDDEN:
            spec.delete(geom)
    last = max(spec.body("ground").geoms, key=lambda geom: float(geom.pos[0]))
    begin = float(last.pos[0] - last.size[0])
    end = max(float(last.pos[0] + last.size[0]), options.corridor_length + 2.0)
    last.pos[0], last.size[0] = (begin + end) / 2, (end - begin) / 2


def _light(spec: mujoco.MjSpec, trunk: str) -> None:
    """Add a light that follows the ant; the other walkers bring their own."""
    if not spec.lights:
        spec.body(trunk).add_light(pos=[0, 0, 4], mode=mujoco.mjtCamLight.mjCAMLIGHT_TRACKCOM)


def _start(model: mujoco.MjModel, upright: list[float], *, settles: bool) -> list[float]:
    """Positions [nq]: upright on the ground, and settled there if the walker stands without control."""
    data = mujoco.MjData(model)
    # A ball with a head slides along the axes and turns about z; it has no free joint.
    is_free = model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE
    data.qpos[: 7 if is_free else 3] = upright[: 7 if is_free else 3]
    if settles:
        mujoco.mj_step(model, data, round(_SETTLING_S / model.opt.timestep))
        data.qpos[:2] = upright[:2]
    return np.array(data.qpos).tolist()
