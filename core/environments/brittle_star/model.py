"""The brittle star: composed by biorobot, and as it is stepped, without sensors that nothing reads."""

from typing import Any

import mujoco
import numpy as np

from core.environments import optional_packages
from core.environments.brittle_star.options import (
    DISK,
    DISK_RADIUS_M,
    LIGHT_MAP_RESOLUTION,
    DirectedOptions,
    LightEscapeOptions,
    Options,
    observed,
)
from core.environments.dm_control.dm_control_import import without_a_display
from core.installation import to_install


def composed(options: Options) -> mujoco.MjSpec:
    """The specification: a free disk with arms, on the ground between walls; the task's target or sand.

    Raises JobFailed("bad_model") if biorobot, which brings both, is not installed.
    """
    with without_a_display():
        arena, star = _arena(options), _star(options)
        arena.attach(star, free_joint=True)
        return mujoco.MjSpec.from_string(arena.get_mjcf_str())


def _star(options: Options) -> Any:
    default = _module("biorobot.brittle_star.mjcf.morphology.specification.default")
    specification = default.default_brittle_star_morphology_specification(
        num_arms=options.num_arms,
        num_segments_per_arm=options.segments,
        use_p_control=options.actuation == "p_control",
        use_torque_control=options.actuation == "torque_control",
    )
    return _module("core.environments.brittle_star.even_star").EvenStar(specification)


def _arena(options: Options) -> Any:
    aquarium = _module("biorobot.brittle_star.mjcf.arena.aquarium")
    return aquarium.MJCFAquariumArena(
        aquarium.AquariumArenaConfiguration(
            size=options.arena_size,
            sand_ground_color=isinstance(options, LightEscapeOptions),
            light_map_resolution=LIGHT_MAP_RESOLUTION,
            attach_target=isinstance(options, DirectedOptions),
        )
    )


def _module(name: str) -> Any:
    brings, install = "Brittle stars and their aquarium come with biorobot", to_install("brittle-star")
    return optional_packages.module(name, brings=brings, install=install)


# The extent that a picture shows, in metres: the star's surroundings, not the whole arena.
_EXTENT_M = 4.0
_START_HEIGHT_M = 0.11
_FREE_BODY = "BrittleStarMorphology/"


def star_model(options: Options) -> mujoco.MjModel:
    """The star in its aquarium; the numeric `init_qpos` is where it begins.

    A fixed target is put in its place. Without contacts with the walls, slides with limits and a ball joint
    replace the free joint: the coordinates and the motion are the same, up to the limits.
    """
    spec = composed(options)
    spec.option.timestep = options.timestep
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_EULERDAMP  # as in biorobot
    spec.stat.extent = _EXTENT_M
    for light in spec.lights:  # without it, a lifted arm is hard to see
        light.diffuse = [0.6] * 3
    reads_contacts = "segment_contact" in observed(options)
    for sensor in list(spec.sensors):
        if sensor.type != mujoco.mjtSensor.mjSENS_TOUCH or not reads_contacts:
            spec.delete(sensor)
    if options.num_arms != 5:
        _shape_disk(spec, options.num_arms)
    if options.walls == "bound":
        _bound(spec, [size - DISK_RADIUS_M for size in options.arena_size])
    if isinstance(options, DirectedOptions) and options.target_position is not None:
        spec.body("target").pos[:2] = options.target_position
    start = [options.start_x, 0.0, _START_HEIGHT_M, 1.0, 0.0, 0.0, 0.0]
    spec.add_numeric(name="init_qpos", data=[*start, *[0.0] * 2 * sum(options.segments)], size=0)
    return spec.compile()


def _shape_disk(spec: mujoco.MjSpec, num_arms: int) -> None:
    """Give the disk a side and a socket for each arm; biorobot's is a pentagon with five sockets."""
    half = np.pi / num_arms
    inner = DISK_RADIUS_M * np.cos(half) / 2
    _repeat(
        spec, "pentagon_side", num_arms, first=half, radius=inner, size=(inner, DISK_RADIUS_M * np.sin(half))
    )
    _repeat(spec, "arm_connector", num_arms, first=0.0)


def _repeat(
    spec: mujoco.MjSpec,
    kind: str,
    number: int,
    *,
    first: float,
    radius: float | None = None,
    size: tuple[float, float] | None = None,
) -> None:
    """Put `number` geoms of this kind around the disk, from the angle `first` on, in place of the five."""
    disk = spec.body(DISK)
    old = [geom for geom in disk.geoms if f"_{kind}_" in geom.name]
    like = old[0]
    distance = float(np.linalg.norm(like.pos)) if radius is None else radius
    extents = like.size.copy() if size is None else np.array([*size, like.size[2]])
    look = {
        name: getattr(like, name) for name in ("type", "rgba", "contype", "conaffinity", "condim", "mass")
    }
    for geom in old:
        spec.delete(geom)
    for index in range(number):
        angle = first + 2 * np.pi * index / number
        disk.add_geom(
            name=f"{DISK}_{kind}_{index}",
            pos=[distance * np.cos(angle), distance * np.sin(angle), 0.0],
            quat=[np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)],
            size=extents,
            **look,
        )


def _bound(spec: mujoco.MjSpec, reach: list[float]) -> None:
    """Keep the disk's centre within ± reach [2], in metres; the walls are only for show."""
    for geom in list(spec.worldbody.geoms):
        if geom.name.endswith("_wall_collider"):
            spec.delete(geom)
    body = spec.body(_FREE_BODY)
    for joint in list(body.joints):
        spec.delete(joint)
    slide, ball = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_BALL
    for name, axis, bound in zip("xy", np.eye(3), reach, strict=False):
        body.add_joint(name=name, type=slide, axis=axis, limited=True, range=[-bound, bound])
    body.add_joint(name="z", type=slide, axis=[0, 0, 1])
    body.add_joint(name="rotation", type=ball)
