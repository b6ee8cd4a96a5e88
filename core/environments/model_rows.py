"""The rows of a model's field that belong to its named geoms, bodies, joints or actuators."""

from collections.abc import Sequence

import mujoco
import numpy as np

from core.environments.randomization import Kind


def object_names(model: mujoco.MjModel, kind: Kind) -> list[str]:
    """Names in MuJoCo's order; empty for an object without one."""
    counts = {"actuator": len(model.actuator_gear), "body": model.nbody, "geom": model.ngeom}
    get = getattr(model, kind)
    return [str(get(number).name) for number in range(counts.get(kind, model.njnt))]


def rows_of(model: mujoco.MjModel, field: str, number: int) -> Sequence[int]:
    """The rows of an object. In `dof_` fields, a joint has one per degree of freedom; everything else has one
    row."""
    if not field.startswith("dof_"):
        return [number]
    return np.flatnonzero(model.dof_jntid == number).tolist()
