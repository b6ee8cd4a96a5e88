"""A dm_control walker in a dm_control corridor, as that library composes them."""

from importlib import import_module
from typing import Any

import mujoco
import numpy as np

from core.environments.dm_control.corridor.info import CorridorOptions
from core.environments.dm_control.corridor.walkers import WALKERS
from core.environments.dm_control.dm_control_import import without_a_display
from core.errors import JobFailed
from core.reasons import Reason


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
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        raise JobFailed(
            Reason.BAD_MODEL,
            f"Corridors and their walkers come with dm_control, which this worker does not have ({error}). "
            "Install it in its clone with `uv sync --inexact --extra dm-control`, or ask for another "
            "environment.",
        ) from error
