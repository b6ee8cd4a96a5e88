"""How many slots contacts need at once: of a model, by a short simulation in C MuJoCo.

On a GPU each thread has room for all of its slots, and a card keeps as much for every thread that it could
run. On a CPU the environments of a vector share slots, and room costs next to nothing.
"""

import copy
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache

import mujoco
import numpy as np
from numpy.typing import NDArray

from mujoco_compiled.constraints.contacts import ContactPair, Looks

# Slots of a kind: as many as there are unless less is known to do, and the least.
MOST_SLOTS, _LEAST_SLOTS = 512, 64
# More would fill the memory that a thread has.
MOST_NCONMAX = 1024
# Two geoms may have more only on a height field.
_MANY_POINTS = 8
_TRIALS, _STEPS, _STEPS_PER_CONTROL, _STEPS_PER_COUNT = 8, 300, 10, 5
# What is begun in other poses than the model's own, and what is pressed down by twice its weight.
_TURNED, _PRESSED, _PRESSURE = 2, 6, 2.0

Room = Callable[[ContactPair], int]
"""For how many points there are slots of a contact's kind."""


def room_of_lanes(nconmax: int | None = None) -> Room:
    """For environments that share slots: for what each may need, and as many as there are in any case."""
    most = max(MOST_SLOTS, nconmax or 0)
    return lambda contact: most


def room_of_one(model: mujoco.MjModel, contacts: Sequence[ContactPair], nconmax: int | None) -> Room:
    """For an environment that has slots for itself. nconmax: None: twice what it needs in a simulation."""
    if nconmax is not None:
        return lambda contact: nconmax
    found = cache(lambda: most_points(model, contacts))
    return lambda contact: min(MOST_SLOTS, max(_LEAST_SLOTS, -8 * (-2 * found()[contact.looks] // 8)))


def most_points(model: mujoco.MjModel, contacts: Sequence[ContactPair]) -> Mapping[Looks, int]:
    """By kind: the most points at which the contacts could push at once while random controls move the model
    from its own pose and keyframes, and from poses in which it falls and is pressed to the ground.

    Geoms that touch count with as many points as they may have, and on height fields with those that they
    have. The same model has the same numbers.
    """
    of_pair = {frozenset((one.one.number, one.other.number)): one for one in contacts}
    most, random = Counter({one.looks: 0 for one in contacts}), np.random.default_rng(0)
    with _no_warnings():
        for data in _moving(model, random):
            now = Counter[Looks]()
            for pair, number in Counter(map(frozenset, data.contact.geom.tolist())).items():
                if (one := of_pair.get(pair)) is not None:
                    now[one.looks] += max(number, min(one.num_points, _MANY_POINTS))
            most |= now
    return most


@contextmanager
def _no_warnings() -> Generator[None]:
    """A pose in which parts are deep in each other may burst: that is no concern of the user's."""
    told = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(told)


def _moving(model: mujoco.MjModel, random: np.random.Generator) -> Iterator[mujoco.MjData]:
    moved = copy.copy(model)
    for trial in range(_TRIALS):
        data = _begun(model, trial, random)
        moved.opt.gravity[:] = model.opt.gravity * (_PRESSURE if trial >= _PRESSED else 1.0)
        for step in range(_STEPS):
            if step % _STEPS_PER_CONTROL == 0:
                data.ctrl[:] = _controls(model, random, at_ends=trial % 2 == 1)
            mujoco.mj_step(moved, data)
            if step % _STEPS_PER_COUNT == 0:
                yield data


def _begun(model: mujoco.MjModel, trial: int, random: np.random.Generator) -> mujoco.MjData:
    data = mujoco.MjData(model)
    if trial < _TURNED and model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, trial % model.nkey)
    if trial >= _TURNED:
        for kind, first, limits in zip(model.jnt_type, model.jnt_qposadr, model.jnt_range, strict=True):
            if kind in (mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_BALL):
                turn = first + 3 * (kind == mujoco.mjtJoint.mjJNT_FREE)
                data.qpos[turn : turn + 4] = random.normal(size=4)
            elif limits[0] < limits[1]:
                data.qpos[first] = random.uniform(*limits)
        mujoco.mj_normalizeQuat(model, data.qpos)
    data.qvel[:] = random.normal(size=model.nv)
    return data


def _controls(model: mujoco.MjModel, random: np.random.Generator, *, at_ends: bool) -> NDArray[np.float64]:
    """[nu], anywhere in their ranges, or at one of the ends, where a learning policy often holds them."""
    low, high = np.where(model.actuator_ctrllimited.astype(bool), model.actuator_ctrlrange.T, [[-1.0], [1.0]])
    drawn = random.uniform(low, high)
    return np.where(drawn < 0.5 * (low + high), low, high) if at_ends else drawn
