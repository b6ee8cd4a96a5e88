"""Arrows above a body: the velocity that it is told, and the one that it has.

A straight one shows where the body goes, and an arc by how much it turns in a second. The page draws the
same, in api/pages/lib/replay/arrow.js.
"""

from collections.abc import Callable
from functools import partial
from itertools import pairwise
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from core.rendering.scene import TARGET_COLOUR, TARGET_SHARE, CameraView

Floats = NDArray[np.float64]

# Colours (red, green, blue) of the command, and of the velocity that is measured.
_COLOURS = ((0.184, 0.435, 0.871), (0.941, 0.627, 0.125))
# The length of an arrow for each m/s, in radii of the body.
_LENGTH = 1.0
# Also in radii: heights over the body's highest point; radii of arc and shaft; radius and length of a tip.
_ABOVE, _ARC, _SHAFT, _TIP, _TIP_LENGTH = (0.14, 0.3), 0.55, 0.018, 0.05, 0.15
# Below this, in m/s and rad/s, nothing is drawn; of a faster turn than this, in rad/s, no more.
_SLOWEST, _FASTEST_TURN = 0.03, 5.5
# The angle of a straight part of an arc, in rad, and the number of discs of a tip.
_PART_OF_ARC, _DISCS = 0.12, 8


def add(scene: Any, view: CameraView, at: Floats, turned: Floats, velocities: Floats) -> None:
    """Add them to the scene. at: [3], the body's place; turned: [9], its rotation; velocities: [2, 3], see
    `EpisodeMotion`."""
    facing = np.arctan2(turned[3], turned[0])
    reach = _ARC * view.radius
    for (forward, left, turn), colour, above in zip(velocities, _COLOURS, _ABOVE, strict=True):
        middle = np.add(at, (0.0, 0.0, view.top + above * view.radius))
        if (speed := float(np.hypot(forward, left))) > _SLOWEST:
            way = facing + np.arctan2(left, forward)
            line = partial(_on_line, middle, way)
            _arrow(scene, view.radius, line, _LENGTH * speed * view.radius, 1, colour)
        if abs(turn) > _SLOWEST:
            angle = float(np.clip(turn, -_FASTEST_TURN, _FASTEST_TURN))
            curve = partial(_on_arc, middle, facing, np.copysign(reach, angle))
            _arrow(scene, view.radius, curve, reach * abs(angle), 2 + int(abs(angle) / _PART_OF_ARC), colour)


def mark(scene: Any, view: CameraView, at: Floats) -> None:
    """Add a ball where the body is to go. at: [2 or 3]; without a height it is on the ground."""
    if scene.ngeom < scene.maxgeom:
        size = np.array([TARGET_SHARE * view.radius, 0.0, 0.0])
        place, colour = np.append(at, 0.0)[:3], np.array(TARGET_COLOUR, np.float32)
        geom, sphere = scene.geoms[scene.ngeom], mujoco.mjtGeom.mjGEOM_SPHERE
        mujoco.mjv_initGeom(geom, sphere, size, place, np.eye(3).ravel(), colour)
        scene.ngeom += 1


def _on_line(start: Floats, angle: float, way: float) -> Floats:
    """The point [3] of a level line after `way` m."""
    return start + way * np.array([np.cos(angle), np.sin(angle), 0.0])


def _on_arc(middle: Floats, start: float, radius: float, way: float) -> Floats:
    """The point [3] of a level circle after `way` m from the angle `start`; to the left if radius > 0."""
    return _on_line(middle, start + way / radius, abs(radius))


def _arrow(
    scene: Any,
    radius: float,
    point: Callable[[float], Floats],
    length: float,
    num_parts: int,
    colour: tuple[float, ...],
) -> None:
    """An arrow of this length in m. point: of its line after a way in m. radius: of the body, in m."""
    tip = min(_TIP_LENGTH * radius, length)
    size = radius * tip / (_TIP_LENGTH * radius)  # The tip of a short arrow is smaller.
    for begin, end in pairwise(np.linspace(0.0, length - tip, num_parts + 1)):
        _connect(scene, mujoco.mjtGeom.mjGEOM_CAPSULE, _SHAFT * size, point(begin), point(end), colour)
    edges = np.linspace(0.0, 1.0, _DISCS + 1)
    neck, along = point(length - tip), point(length) - point(length - tip)
    for begin, end in pairwise(edges):
        width = _TIP * size * (1.0 - 0.5 * (begin + end))
        _connect(
            scene, mujoco.mjtGeom.mjGEOM_CYLINDER, width, neck + begin * along, neck + end * along, colour
        )


def _connect(
    scene: Any, kind: mujoco.mjtGeom, width: float, begin: Floats, end: Floats, colour: tuple[float, ...]
) -> None:
    if scene.ngeom >= scene.maxgeom:
        return
    geom = scene.geoms[scene.ngeom]
    rgba = np.array([*colour, 1.0], np.float32)
    mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.eye(3).ravel(), rgba)
    mujoco.mjv_connector(geom, kind, width, begin, end)
    geom.emission, geom.specular, geom.category = 0.3, 0.1, mujoco.mjtCatBit.mjCAT_DECOR
    scene.ngeom += 1
