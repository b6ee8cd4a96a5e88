"""The numbers of a star's observation and action by name."""

from collections.abc import Iterator
from math import pi

from core.environments.brittle_star.observables import Observable
from core.environments.brittle_star.options import Options, observed
from core.environments.spaces import Slice, Spaces, in_order, named

# biorobot's joints: half ranges in the plane and out of it.
_RANGES_RAD = (pi / 4, pi / 6)
# biorobot's strength of the first segment's motors; the last would have half of it.
_STRENGTH_NM = 3.75
_AXES = ("x", "y", "z")


def star_slices(options: Options) -> Spaces:
    """The observables of the options, and what an action sets."""
    seen = [_observable(name, options) for name in observed(options)]
    acts = _of_joints(options) if options.control == "joints" else _of_a_generator(options)
    return Spaces(in_order(seen), in_order(acts))


def _observable(name: Observable, options: Options) -> Slice:  # noqa: C901 # A table.
    segments = [f"arm_{arm}_segment_{segment}" for arm, segment, _ in _segments(options)]
    joints = list(_joints(options))
    match name:
        case "joint_position":
            return named(name, joints, "rad")
        case "joint_velocity":
            return named(name, joints, "rad/s")
        case "joint_actuator_force" | "actuator_force":
            return named(name, joints, "N m", -_STRENGTH_NM, _STRENGTH_NM)
        case "disk_position":
            return named(name, _AXES, "m")
        case "disk_rotation":
            return named(name, ("roll", "pitch", "yaw"), "rad", -pi, pi)
        case "disk_linear_velocity":
            return named(name, _AXES, "m/s")
        case "disk_angular_velocity":
            return named(name, _AXES, "rad/s")
        case "segment_contact":
            return named(name, segments, "N", 0.0)
        case "unit_xy_direction_to_target":
            return named(name, _AXES[:2], "1", -1.0, 1.0)
        case "xy_distance_to_target":
            return named(name, ("distance",), "m", 0.0)
        case "segment_light_intake":
            return named(name, segments, "1", 0.0, 1.0)
        case "disk_light_intake":
            return named(name, ("disk",), "1", 0.0, 1.0)


def _segments(options: Options) -> Iterator[tuple[int, int, int]]:
    """Each segment's arm, its number in the arm, and how many the arm has; outwards, arm by arm."""
    for arm, number in enumerate(options.segments):
        for segment in range(number):
            yield arm, segment, number


def _joints(options: Options) -> Iterator[str]:
    for arm, segment, _ in _segments(options):
        for plane in ("in_plane", "out_of_plane"):
            yield f"BrittleStarMorphology/arm_{arm}_segment_{segment}_{plane}_joint"


def _of_joints(options: Options) -> Iterator[Slice]:
    """A servo's angle or a torque at each joint."""
    names = iter(_joints(options))
    for _, segment, number in _segments(options):
        torque = _STRENGTH_NM * (1 - segment / number / 2)
        for angle in _RANGES_RAD:
            most, unit = (angle, "rad") if options.actuation == "p_control" else (torque, "N m")
            name = f"{next(names)}_{options.actuation}"
            yield named(name, (name,), unit, -most, most)


def _of_a_generator(options: Options) -> Iterator[Slice]:
    """What oscillators tend to, in the order of `cpg.encoding`; 1 is the end of an actuator's range."""
    cpg, arms = options.cpg, range(options.num_arms)
    oscillators = [f"arm {arm} {plane}" for arm in arms for plane in ("in plane", "out of plane")]
    after = [(arm + 1) % options.num_arms for arm in arms]
    edges = [
        *(f"arm {arm} in plane to out of plane" for arm in arms),
        *(f"arm {arm} to arm {after[arm]} in plane" for arm in arms),
        *(f"arm {arm} to arm {after[arm]} out of plane" for arm in arms),
    ]
    yield named("amplitude", oscillators, "1", 0.0, cpg.max_amplitude)
    yield named("offset", oscillators, "1", -cpg.max_offset, cpg.max_offset)
    yield named("phase_bias", edges, "rad", -pi, pi)
    yield named("frequency", ("all oscillators",), "rad/s", 0.0, cpg.max_frequency)
