"""A biorobot brittle star in a biorobot aquarium, as that library composes them."""

from importlib import import_module
from typing import Any

import mujoco

from core.environments.brittle_star.options import (
    LIGHT_MAP_RESOLUTION,
    DirectedOptions,
    LightEscapeOptions,
    Options,
)
from core.environments.dm_control.dm_control_import import without_a_display
from core.errors import JobFailed
from core.reasons import Reason


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
    return _module("core.environments.brittle_star.morphology").EvenStar(specification)


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
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        raise JobFailed(
            Reason.BAD_MODEL,
            f"Brittle stars and their aquarium come with biorobot, which this worker lacks ({error}). "
            "Install it in its clone with `uv sync --inexact --extra brittle-star`, or ask for another "
            "environment.",
        ) from error
