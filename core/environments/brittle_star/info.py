"""The rows of the brittle stars in the catalog, their options' effects, and the numbers they observe."""

from collections.abc import Iterator, Mapping
from math import pi
from typing import Any

from core.environments.brittle_star.options import (
    DISK,
    OF_THE_WAY,
    DirectedOptions,
    LightEscapeOptions,
    Observable,
    Options,
    UndirectedOptions,
    observed,
)
from core.environments.info import EnvironmentInfo, FiniteSpace, FiniteViews, Slice, Spaces, in_order, named
from core.physics.availability import EngineName, Rule

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
    """The targets of oscillators, in the order of `cpg.encoding`; 1 is the end of an actuator's range."""
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


# MJX unrolls every joint into one program: compiling it for 50 segments took 84 s of CPU time.
_MAX_SEGMENTS_ON_MJX = 50
_ON_A_CPU = (
    Rule("compiled", 8, "Measured on two cores: 10.2 k control steps/s of Q-learning, 1.8 k by native."),
)
_WALLED_ON_A_CPU = (
    Rule(
        "compiled",
        64,
        "Measured on two cores: physics 4 × that of native, after 40 s in which its code is made.",
    ),
)
# With more segments an arm's code outgrows what one function holds, and is far slower.
_MOST_SEGMENTS_ON_A_GPU = 5
_COMPILED_ON_A_GPU = Rule(
    "compiled", 1, "Measured on an H200: 0.79 M control steps/s of physics, 0.20 M by warp."
)
_ON_A_GPU = (
    Rule("warp", 1, "Measured on an H200: 243 k actions/s in training, 21 k by native on 16 cores."),
    Rule("native", 1, "MJX takes 7.7 k steps/s on an H200, C MuJoCo 20 k on one core."),
)


def _under(options: Options) -> Mapping[str, Any]:
    """The fields of the row that these options change."""
    numbers = star_slices(options)
    return {
        "observation_size": numbers.observation_size,
        "action_size": numbers.action_size,
        "finite": _finite(options),
        "dt": options.dt,
        "episode_length": options.episode_length,
        "cannot_run": _cannot_run(options),
        "on_a_cpu": _WALLED_ON_A_CPU if options.walls == "contacts" else _ON_A_CPU,
        "on_a_gpu": (_COMPILED_ON_A_GPU, *_ON_A_GPU) if _is_quick_on_a_gpu(options) else _ON_A_GPU,
    }


def _is_quick_on_a_gpu(options: Options) -> bool:
    """Whether each arm is a thread's, in one function; see `mujoco_compiled.code.function_source`."""
    alike = len(set(options.segments)) == 1 and options.segments[0] <= _MOST_SEGMENTS_ON_A_GPU
    return alike and options.walls != "contacts"


def _finite(options: Options) -> FiniteViews:
    arms, states = options.num_arms, dict[str, FiniteSpace]()
    if isinstance(options, DirectedOptions):
        # As many sides and roles as `discretization.num_sides` and `cpg.roles.roles_for` say, which load JAX.
        states = {
            "arm_towards_target": FiniteSpace(arms),
            "arm_role": FiniteSpace(arms, arms),
            "arm_side": FiniteSpace(3 + (arms % 2 == 0), arms),
        }
    if options.control == "cpg":
        sets = {
            "leading_arm": FiniteSpace(arms),
            "arm_roles": FiniteSpace(3 + (arms % 2 == 0), arms),
            "arm_amplitudes": FiniteSpace(3, arms),
        }
        why = {"arm_actions": "its action sets a central pattern generator, and not each arm's joints"}
        if missing := [str(arm) for arm, count in enumerate(options.segments) if count == 0]:
            del sets["arm_amplitudes"]
            why["arm_amplitudes"] = f"num_segments_per_arm leaves out arm {', '.join(missing)}"
        return FiniteViews(states, sets, cannot_offer=why)
    generator = 'it has a central pattern generator only with the option "control": "cpg"'
    why: dict[str, str] = dict.fromkeys(("leading_arm", "arm_roles", "arm_amplitudes"), generator)
    if len(set(options.segments)) == 1:
        return FiniteViews(states, action_parts=arms, cannot_offer=why)
    return FiniteViews(states, cannot_offer={**why, "arm_actions": "its arms differ in their joints"})


def _cannot_run(options: Options) -> Mapping[EngineName, str]:
    cannot: dict[EngineName, str] = {}
    num_segments = sum(options.segments)
    if num_segments > _MAX_SEGMENTS_ON_MJX:
        cannot["mjx"] = (
            f"The star has {num_segments} segments, and MJX does not compile in time with more than "
            f"{_MAX_SEGMENTS_ON_MJX}. Choose native or warp, or fewer segments."
        )
    return cannot


def _row(id: str, task: str, description: str, options: type[Options]) -> EnvironmentInfo:
    return EnvironmentInfo(
        id=id,
        description=description,
        factory=f"core.environments.brittle_star.environment:{task}",
        package="biorobot",
        tracked_body=DISK,
        cameras=("top_camera", "BrittleStarMorphology/side_camera"),
        info=(
            *("disk_position", "disk_rotation"),
            *(OF_THE_WAY if options is DirectedOptions else ()),
        ),
        options=options,
        vary=_under,
        slices=star_slices,
        **_under(options.model_validate({})),
    )


DIRECTED = _row(
    "brittle_star",
    "directed",
    "biorobot's brittle star in an aquarium, rewarded for coming nearer to a target.",
    DirectedOptions,
)
UNDIRECTED = _row(
    "brittle_star_undirected",
    "undirected",
    "biorobot's brittle star in an aquarium, rewarded for moving away from the middle.",
    UndirectedOptions,
)
LIGHT_ESCAPE = _row(
    "brittle_star_light_escape",
    "light_escape",
    "biorobot's brittle star in an aquarium, rewarded for getting out of the light.",
    LightEscapeOptions,
)
INFOS = (DIRECTED, UNDIRECTED, LIGHT_ESCAPE)
