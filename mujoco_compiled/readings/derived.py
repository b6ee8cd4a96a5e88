"""Derived fields of a state, with MuJoCo's names and shapes, flattened.

They follow from its positions and velocities alone. `qfrc_actuator` is the last substep's: `substep.Moved`.
"""

from collections.abc import Callable, Mapping

import mujoco

from mujoco_compiled.program.arithmetic import Vector
from mujoco_compiled.readings.scene import Scene
from mujoco_compiled.readings.sensors import sensor_values


def derived(scene: Scene, names: tuple[str, ...]) -> dict[str, Vector]:
    """The named fields of `engine.DERIVED_FIELDS`; nothing else is computed."""
    return {name: _COMPUTED[name](scene) for name in names}


def _flat(rows: list[Vector]) -> Vector:
    return [number for row in rows for number in row]


def _positions(scene: Scene, kind: mujoco.mjtObj, number: int) -> Vector:
    return _flat([scene.position(scene.frame(kind, place)) for place in range(number)])


_COMPUTED: Mapping[str, Callable[[Scene], Vector]] = {
    "cinert": lambda scene: _flat(scene.motion.inertias),
    "cvel": lambda scene: _flat(scene.motion.velocities),
    "geom_xpos": lambda scene: _positions(scene, mujoco.mjtObj.mjOBJ_GEOM, scene.fields.model.ngeom),
    "sensordata": sensor_values,
    "site_xpos": lambda scene: _positions(scene, mujoco.mjtObj.mjOBJ_SITE, scene.fields.model.nsite),
    "subtree_com": lambda scene: _flat(scene.means(scene.poses.centres)),
    "ten_length": lambda scene: [one.length for one in scene.posture.tendons],
    "xmat": lambda scene: _flat([_flat(rotation) for rotation in scene.poses.rotations]),
    "xpos": lambda scene: _flat(scene.poses.positions),
    "xquat": lambda scene: _flat(scene.poses.quaternions),
}
DERIVED_FIELDS = (*_COMPUTED, "qfrc_actuator")
