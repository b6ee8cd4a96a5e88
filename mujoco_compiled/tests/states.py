"""States of bodies that fall and writhe on the floor, and how far results are apart."""

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from mujoco_compiled.tests.bodies import brax_model

NUM_STATES = 64
# Our solver leaves no error with these. A line search may end within the solver's own tolerance, as the next
# iteration goes on from there: below it, rounding alone would end most of them, after three times as long.
THOROUGH: dict[str, Any] = {"iterations": 20, "line_search_iterations": 30, "line_search_tolerance": 1.0}
Arrays = list[NDArray[np.float64]]


def converged(name: str, *, implicit_damping: bool) -> mujoco.MjModel:
    return converge(brax_model(name), implicit_damping=implicit_damping)


def converge(model: mujoco.MjModel, *, implicit_damping: bool) -> mujoco.MjModel:
    """The model itself, with settings with which MuJoCo's solver leaves no error."""
    model.opt.iterations, model.opt.ls_iterations = 100, 50
    model.opt.tolerance, model.opt.ls_tolerance = 1e-15, 1e-6
    if not implicit_damping:
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP)
    return model


def states(model: mujoco.MjModel, num_states: int = NUM_STATES) -> list[mujoco.MjData]:
    """As they come about where a body falls and writhes on the floor; each of them has contacts."""
    generator, found = np.random.default_rng(0), list[mujoco.MjData]()
    limited = model.actuator_ctrllimited.astype(bool)
    low, high = np.where(limited, model.actuator_ctrlrange.T, [[-1.0], [1.0]])
    while len(found) < num_states:
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = initial_qpos(model), 0.1 * generator.normal(size=model.nv)
        for step in range(200 + 10 * NUM_STATES):
            if step % 10 == 0:
                share = 0.3 * generator.uniform(-0.5, 0.5, size=model.nu)
                data.ctrl[:] = 0.5 * (low + high) + share * (high - low)
            mujoco.mj_step(model, data)
            if step >= 200 and step % 10 == 9 and data.ncon:
                kept = mujoco.MjData(model)
                mujoco.mj_copyData(kept, model, data)
                found.append(kept)
    return found[:num_states]


def initial_qpos(model: mujoco.MjModel) -> NDArray[np.float64]:
    """[nq]: the model's custom numeric `init_qpos`, as Brax's bodies have it, or `qpos0`."""
    numerics = (model.numeric(index) for index in range(model.nnumeric))
    own = (numeric.data for numeric in numerics if numeric.name == "init_qpos")
    return np.array(next(own, model.qpos0))


def of_all(datas: list[mujoco.MjData], field: str) -> Arrays:
    return list(np.stack([getattr(data, field) for data in datas], axis=1))


def relative(ours: Arrays, theirs: Arrays) -> float:
    """The largest relative error of a state's vector."""
    return float(relative_of_each(ours, theirs).max())


def relative_of_each(ours: Arrays, theirs: Arrays) -> NDArray[np.float64]:
    """The relative error of each state's vector, [states]."""
    apart = np.linalg.norm(np.stack(np.broadcast_arrays(*ours)) - np.stack(theirs), axis=0)
    return apart / np.linalg.norm(np.stack(theirs), axis=0)
