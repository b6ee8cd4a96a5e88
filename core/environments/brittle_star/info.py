"""The rows of the brittle stars in the catalog, and how their options change them."""

from collections.abc import Mapping
from typing import Any

from core.environments.brittle_star.observables import OF_THE_WAY, size_of
from core.environments.brittle_star.options import (
    DISK,
    DirectedOptions,
    LightEscapeOptions,
    Options,
    UndirectedOptions,
    observed,
)
from core.environments.brittle_star.slices import star_slices
from core.environments.info import EnvironmentInfo, FiniteSpace, FiniteViews
from core.physics.availability import EngineName, Rule, beyond_compiled

# `core.physics.compiled.coverage.MOST_ROWS`, which cannot be imported without MuJoCo.
_MOST_ROWS = 2_000
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
    total = sum(options.segments)
    return {
        "observation_size": sum(size_of(name, total) for name in observed(options)),
        # A pattern generator's size: `core.environments.cpg.encoding.action_size`, but that loads JAX.
        "action_size": 2 * total if options.control == "joints" else 7 * options.num_arms + 1,
        "finite": _finite(options),
        "dt": options.dt,
        "episode_length": options.episode_length,
        "cannot_run": _cannot_run(options),
        "on_a_cpu": _WALLED_ON_A_CPU if options.walls == "contacts" else _ON_A_CPU,
        "on_a_gpu": (_COMPILED_ON_A_GPU, *_ON_A_GPU) if _is_quick_on_a_gpu(options) else _ON_A_GPU,
    }


def _is_quick_on_a_gpu(options: Options) -> bool:
    """Whether each arm is a thread's, in one function; see `core.physics.compiled.code.piece`."""
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
    if reason := _beyond_compiled(options):
        cannot["compiled"] = beyond_compiled(reason)
    num_segments = sum(options.segments)
    if num_segments > _MAX_SEGMENTS_ON_MJX:
        cannot["mjx"] = (
            f"The star has {num_segments} segments, and MJX does not compile in time with more than "
            f"{_MAX_SEGMENTS_ON_MJX}. Choose native or warp, or fewer segments."
        )
    return cannot


def _beyond_compiled(options: Options) -> str | None:
    """What the engine `compiled` lacks."""
    num_segments = sum(options.segments)
    # Rows of the disk, of each segment's limits and points, and of their contacts with the walls.
    rows = 26 + 14 * num_segments + (94 + 48 * num_segments if options.walls == "contacts" else 0)
    if rows > _MOST_ROWS:
        return f"it can have more than {_MOST_ROWS} constraint rows at once"
    return None


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
