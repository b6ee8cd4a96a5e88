"""One step as the terms see it, and a term that is bound to a model."""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import mujoco
import numpy as np

from core.physics.engine import PhysicsState


@dataclass(frozen=True)
class StepContext:
    """A step of one environment.

    before, after: the physics before and after it. action, previous_action: [nu], each in [-1, 1]; the
    latter is zero in an episode's first step. dt: its duration in seconds.
    """

    before: PhysicsState
    after: PhysicsState
    action: jax.Array
    previous_action: jax.Array
    dt: float


@dataclass(frozen=True)
class BoundTerm:
    """A term of one model. derived: the fields it reads. measure: its value, []; an observation's, [n]."""

    derived: tuple[str, ...]
    measure: Callable[[StepContext], jax.Array]


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

    def sensors(self, names: list[str]) -> np.ndarray:
        """The sensors' places in `sensordata`, one sensor after the other."""
        found = [self.model.sensor(name) for name in names]
        return np.concatenate([np.arange(s.adr[0], s.adr[0] + s.dim[0]) for s in found])

    def free_joint(self, body: int) -> int | None:
        """The first index of the body's free joint in qpos; None if it has none."""
        first = int(self.model.body_jntadr[body])
        if first < 0 or self.model.jnt_type[first] != mujoco.mjtJoint.mjJNT_FREE:
            return None
        return int(self.model.jnt_qposadr[first])

    def position(self, body: int) -> tuple[tuple[str, ...], Callable[[PhysicsState], jax.Array]]:
        """The derived fields to ask for, and a function that reads the body's position [3], in metres."""
        start = self.free_joint(body)
        if start is None:
            return ("xpos",), lambda physics: physics.derived["xpos"][body]
        return (), lambda physics: physics.qpos[start : start + 3]
