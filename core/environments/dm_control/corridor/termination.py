"""Endings of dm_control's `RunThroughCorridor`: a part that is no foot on the ground, a low end effector.

Sensors count contacts, so that every engine reads them alike. They are about a geom and one other, or any:
MJX and `compiled` read no others. Platforms are many, so over gaps a part's contacts with the ground are its
contacts with anything without those with the sides.
"""

from collections.abc import Mapping

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from core.environments.dm_control.corridor.info import CorridorOptions
from core.environments.dm_control.corridor.walkers import WALKERS
from core.physics.engine import PhysicsState

_COUNTED, _TAKEN_OFF = "nonfoot:", "nonfoot_at_side:"


def add_contact_sensors(spec: mujoco.MjSpec, options: CorridorOptions, *, ground: int, sides: int) -> None:
    """Add the sensors that `contact_termination` reads. ground, sides: bits of `contype` of what is so."""
    parts = _nonfoot_geoms(spec, options)
    planes = [geom for geom in spec.worldbody.geoms if geom.contype & (ground | sides)]
    for number, geom in enumerate([*parts, *planes]):
        geom.name = geom.name or f"unnamed_{number}"
    for part in parts:
        if options.arena == "gaps":
            _add(spec, _COUNTED, part, None)
            for side in planes:
                if side.contype & part.conaffinity & sides:
                    _add(spec, _TAKEN_OFF, part, side)
        else:
            [floor] = [plane for plane in planes if plane.contype & ground]
            _add(spec, _COUNTED, part, floor)


def derived_fields(options: CorridorOptions) -> tuple[str, ...]:
    """The fields that `Endings` reads."""
    low = ("xpos",) if options.terminate_at_height is not None else ()
    return (*low, "sensordata") if options.contact_termination else low


class Endings:
    """The endings that the options ask for, over a model that has the sensors."""

    def __init__(self, model: mujoco.MjModel, options: CorridorOptions) -> None:
        names = [model.sensor(number).name for number in range(model.nsensor)]
        self._signs = jnp.array(
            [name.startswith(_COUNTED) - float(name.startswith(_TAKEN_OFF)) for name in names], jnp.float32
        )
        end_effectors = WALKERS[options.walker].end_effectors
        self._end_effectors = np.array([model.body(name).id for name in end_effectors])
        self._options = options

    def __call__(self, physics: PhysicsState) -> Mapping[str, jax.Array]:
        """By the name of its metric: 1 where the ending has come, otherwise 0; [] each."""
        found = dict[str, jax.Array]()
        if self._options.contact_termination:
            number = jnp.dot(self._signs, physics.derived["sensordata"])
            found["nonfoot_contact"] = jnp.where(number > 0, 1.0, 0.0)
        if (least := self._options.terminate_at_height) is not None:
            heights = physics.derived["xpos"][self._end_effectors, 2]
            found["end_effector_too_low"] = jnp.where(jnp.any(heights < least), 1.0, 0.0)
        return found


def _nonfoot_geoms(spec: mujoco.MjSpec, options: CorridorOptions) -> list[mujoco.MjsGeom]:
    """The walker's geoms that can touch something and that dm_control does not call feet."""
    info = WALKERS[options.walker]
    feet = [geom for name in info.feet for geom in spec.body(name).find_all("geom")]
    geoms = spec.body("walker/").find_all("geom")
    return [geom for geom in geoms if geom.conaffinity and geom not in feet]


def _add(spec: mujoco.MjSpec, prefix: str, geom: mujoco.MjsGeom, other: mujoco.MjsGeom | None) -> None:
    """A sensor that counts the geom's contacts with another one, or with any."""
    sensor = spec.add_sensor(
        name=f"{prefix}{geom.name}:{other.name if other else ''}",
        type=mujoco.mjtSensor.mjSENS_CONTACT,
        objtype=mujoco.mjtObj.mjOBJ_GEOM,
        objname=geom.name,
        # The data to read (bit 0: "found", the number of contacts), unsorted, for one contact.
        intprm=[1, 0, 1],
    )
    if other is not None:
        sensor.reftype, sensor.refname = mujoco.mjtObj.mjOBJ_GEOM, other.name
