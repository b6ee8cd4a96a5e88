"""The size of MuJoCo Warp's buffers: they are allocated once, and what does not fit is lost."""

import math
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from core.physics.model import initial_qpos

# A short trial of a few worlds stands for a long training of thousands, so the buffers get twice its maximum;
# a body that touched nothing in the trial may still fall over later.
_ROOM = 2.0
_LEAST_CONTACTS, _LEAST_ROWS = 8, 24
_NUM_TRIALS, _TRIAL_S, _MAX_STEPS, _STEPS_PER_CONTROL = 8, 2.0, 1000, 20


@dataclass(frozen=True)
class Demand:
    """The most that one world needed at any step.

    contacts: contacts, or pairs of geoms near enough to be checked, whichever are more: MuJoCo Warp keeps
    both in buffers of one size. rows: constraint rows (contacts, joint limits, friction, equalities).
    """

    contacts: int
    rows: int


@dataclass(frozen=True)
class Capacity:
    """MuJoCo Warp's sizes. naconmax: contacts of all worlds together; njmax: constraint rows of each."""

    naconmax: int
    njmax: int


def capacity(demand: Demand, num_worlds: int) -> Capacity:
    """Room for `num_worlds` worlds that may need twice the demand, and always for a little."""
    contacts = max(_LEAST_CONTACTS, math.ceil(_ROOM * demand.contacts))
    return Capacity(num_worlds * contacts, max(_LEAST_ROWS, math.ceil(_ROOM * demand.rows)))


def measure(model: mujoco.MjModel, pairs: NDArray[np.integer], *, seed: int = 0) -> Demand:
    """The capacities that a few worlds need while random controls move them from the start of an episode.

    In every other trial each control is at one of its ends, where a learning policy often holds it.
    pairs: [P, 2], the geoms that may touch. C MuJoCo steps the worlds on the host: a few simulated seconds,
    in a fraction of a second.
    """
    random = np.random.default_rng(seed)
    limited = model.actuator_ctrllimited.astype(bool)
    low, high = np.where(limited, model.actuator_ctrlrange.T, [[-1.0], [1.0]])
    num_steps = min(_MAX_STEPS, round(_TRIAL_S / model.opt.timestep))
    contacts, rows = 0, 0
    data = mujoco.MjData(model)
    for trial in range(_NUM_TRIALS):
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = initial_qpos(model), 0.1 * random.standard_normal(model.nv)
        for step in range(num_steps):
            if step % _STEPS_PER_CONTROL == 0:
                within, at_an_end = random.uniform(low, high), random.uniform(size=model.nu) < 0.5
                data.ctrl[:] = within if trial % 2 == 0 else np.where(at_an_end, low, high)
            mujoco.mj_step(model, data)
            contacts = max(contacts, int(data.ncon), num_near(model, data, pairs))
            rows = max(rows, int(data.nefc))
    return Demand(contacts, rows)


def num_near(model: mujoco.MjModel, data: mujoco.MjData, pairs: NDArray[np.integer]) -> int:
    """How many of these pairs [P, 2] of geoms have bounding spheres that touch.

    For a plane, the distance along its normal counts. MuJoCo Warp checks these pairs or fewer, because it
    also tests bounding boxes.
    """
    if len(pairs) == 0:
        return 0
    reach = model.geom_rbound + model.geom_margin
    first, second = pairs[:, 0], pairs[:, 1]
    between = data.geom_xpos[second] - data.geom_xpos[first]
    distance = np.linalg.norm(between, axis=1)
    normals = data.geom_xmat.reshape(-1, 3, 3)[:, :, 2]
    for one, sign in ((first, 1.0), (second, -1.0)):
        is_plane = model.geom_type[one] == mujoco.mjtGeom.mjGEOM_PLANE
        distance = np.where(is_plane, sign * np.sum(between * normals[one], axis=1), distance)
    return int(np.count_nonzero(distance <= reach[first] + reach[second]))
