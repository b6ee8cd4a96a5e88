"""The composed corridor, without the parts that cost time."""

from itertools import pairwise
from math import copysign
from typing import NamedTuple

import mujoco
import numpy as np

from core.environments.dm_control.corridor.aesthetics import HIDDEN, draw
from core.environments.dm_control.corridor.compose import composed
from core.environments.dm_control.corridor.info import CorridorOptions
from core.environments.dm_control.corridor.termination import add_contact_sensors
from core.environments.dm_control.corridor.walkers import WALKERS

_SETTLING_S = 3.0
# The extent that a picture shows, in metres: the walker's surroundings, not forty metres of corridor.
_EXTENT_M = 4.0
# Platforms that are nearer than this touch each other.
_SEAM_M = 1e-6
# Bits of contype (arena) and conaffinity (walker): all parts touch the ground, only the trunk the sides.
_GROUND, _SIDES = 1, 2
# The most that MJX solves for and checks, nearest first; the other engines need no such bound.
_CONTACT_POINTS, _GEOM_PAIRS = 32, 64


def corridor_model(options: CorridorOptions) -> mujoco.MjModel:
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
    return spec.compile()


class Obstacle(NamedTuple):
    """A gap or a wall. begin, end: its extent in x; y: the middle of the way past it, 0 for a gap; all in
    metres."""

    begin: float
    end: float
    y: float


def obstacles(model: mujoco.MjModel) -> list[Obstacle]:
    """The gaps or walls in the order of their ends; none in an empty corridor."""
    geoms = [model.geom(index) for index in range(model.ngeom)]
    extents = {g.name: (float(g.pos[0] - g.size[0]), float(g.pos[0] + g.size[0])) for g in geoms}
    # A wall reaches 2 size[1] in from one side, so the middle of what it leaves is size[1] from the axis.
    walls = [
        Obstacle(*extents[g.name], -copysign(g.size[1], g.pos[1]))
        for g in geoms
        if g.name.startswith("wall_")
    ]
    floors = sorted(extent for name, extent in extents.items() if name.startswith(("start_floor", "floor_")))
    # Between the first platform and the second there is no gap.
    gaps = [Obstacle(end, begin, 0.0) for (_, end), (begin, _) in pairwise(floors) if begin - end > _SEAM_M]
    return sorted(walls or gaps, key=lambda one: one.end)


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
