"""A step of one environment as terms see it, and the places of a model's parts in MuJoCo's arrays."""

from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import mujoco
import numpy as np

from core.environments.terms.contact_sensors import is_ours, sensor_name
from core.environments.terms.term import Array


@dataclass(frozen=True)
class Step:
    """before, after: the physics before and after it, a `PhysicsState` or what has its fields. action,
    previous_action: [nu], each in [-1, 1]; the latter is zero in an episode's first step. dt: its duration
    in seconds. xp: the library of its arrays, `jax.numpy` or `numpy`.
    """

    before: Any
    after: Any
    action: Array
    previous_action: Array
    dt: float
    xp: ModuleType

    def array(self, values: Sequence[float]) -> Array:
        """[n] float32."""
        return self.xp.asarray(values, self.xp.float32)

    def places(self, numbers: Sequence[int]) -> np.ndarray:
        """Indices of an array."""
        return np.array(numbers, int)


@dataclass(frozen=True)
class ModelIndex:
    """The model's parts by name. root: number of the body of the terms that name no body."""

    model: mujoco.MjModel
    root: int

    def body(self, name: str | None) -> int:
        return self.root if name is None else int(self.model.body(name).id)

    def bodies(self, names: list[str] | None) -> np.ndarray:
        """Numbers of the bodies; if None, of all but the world."""
        if names is None:
            return np.arange(1, self.model.nbody)
        return np.array([self.model.body(name).id for name in names])

    def sensors(self, names: list[str] | None) -> np.ndarray:
        """Places in `sensordata`: of the named sensors in their order, or of all of the model's own."""
        model = self.model
        own = (number for number in range(model.nsensor) if not is_ours(model.sensor(number).name))
        chosen = list(own if names is None else (model.sensor(name).id for name in names))
        return np.concatenate(
            [sensor.adr[0] + np.arange(sensor.dim[0]) for sensor in map(model.sensor, chosen)]
        )

    def contacts(self, geoms: list[str], against: str | None) -> np.ndarray:
        """Places in `sensordata` of the numbers of contacts of each geom."""
        return self.sensors([sensor_name(geom, against) for geom in geoms])

    def free_joint(self, body: int) -> int | None:
        """The first index of the body's free joint in qpos; None if it has none."""
        first = int(self.model.body_jntadr[body])
        if first < 0 or self.model.jnt_type[first] != mujoco.mjtJoint.mjJNT_FREE:
            return None
        return int(self.model.jnt_qposadr[first])

    def position(self, physics: Any, body: int) -> Array:
        """The body's position [3], in metres."""
        start = self.free_joint(body)
        return physics.derived["xpos"][body] if start is None else physics.qpos[start : start + 3]

    def velocity(self, step: Step, body: int) -> Array:
        """(p' − p) / dt [3] in m/s, along the world's axes."""
        return (self.position(step.after, body) - self.position(step.before, body)) / step.dt

    def visible_positions(self, num_hidden: int) -> np.ndarray:
        """Places in qpos, without the first `num_hidden` of the root's free joint if it has one."""
        start = self.free_joint(self.root)
        hidden = np.arange(num_hidden) + start if start is not None else []
        return np.setdiff1d(np.arange(self.model.nq), hidden)

    def limited_joints(self, names: list[str] | None) -> np.ndarray:
        """Numbers of these joints; if None, of all hinges and slides that have a range."""
        if names is not None:
            return np.array([self.model.joint(name).id for name in names])
        kinds = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
        return np.flatnonzero(self.model.jnt_limited.astype(bool) & np.isin(self.model.jnt_type, kinds))
