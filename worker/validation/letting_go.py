"""A model that is let go: how fast it steps, where its root ends, and what helps if it bursts."""

import copy
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from core.environments.terms.describe import root_of
from core.environments.terms.inventory import Inventory
from core.physics.coverage import slippery_contacts
from core.physics.model import initial_qpos

_TRIAL_S, _TRIAL_WALL_S, _STEPS_AT_ONCE = 2.0, 0.5, 20
_FAR_M = 5.0
_UNSTABLE = ("mjWARN_BADQPOS", "mjWARN_BADQVEL", "mjWARN_BADQACC")


@dataclass(frozen=True)
class Fall:
    """begun, ended: the root's places in the world [3], in m. stable: whether MuJoCo did not complain."""

    steps_per_second: float
    begun: NDArray[np.float64]
    ended: NDArray[np.float64]
    stable: bool

    @property
    def is_thrown(self) -> bool:
        """Whether it went far, and not down."""
        way = self.ended - self.begun
        return bool(np.linalg.norm(way) > _FAR_M and way[2] > -_FAR_M)


def let_go(model: mujoco.MjModel) -> Fall:
    """Steps it without actions for two seconds, or for as many as can be computed in half a second."""
    data = mujoco.MjData(model)
    data.qpos[:] = initial_qpos(model)
    begun = _place(model, data.qpos)
    steps, began = 0, time.perf_counter()
    while data.time < _TRIAL_S and time.perf_counter() - began < _TRIAL_WALL_S:
        mujoco.mj_step(model, data, _STEPS_AT_ONCE)
        steps += _STEPS_AT_ONCE
    rate = steps / (time.perf_counter() - began)
    ended = _place(model, data.qpos)
    return Fall(rate, begun, ended if np.isfinite(ended).all() else begun, is_stable(data))


def is_stable(data: mujoco.MjData) -> bool:
    """Whether MuJoCo has found no number that is not finite or too large."""
    return not any(data.warning[getattr(mujoco.mjtWarning, kind)].number for kind in _UNSTABLE)


def notes(model: mujoco.MjModel, found: Inventory, fall: Fall) -> Iterator[str]:
    """Sentences about a fall that is not a robot's, with what helps."""
    if not fall.stable:
        yield f"It becomes unstable within 2 s, without any action: {_what_helps(model)}"
    elif fall.is_thrown:
        far = np.linalg.norm(fall.ended - fall.begun)
        yield f"It is {far:.0f} m away within 2 s, without any action: {_what_helps(model)}"
    elif found.travels and (fell := fall.begun[2] - fall.ended[2]) > _FAR_M:
        yield (
            f"It fell {fell:.0f} m within 2 s: there is no floor that it touches. "
            '`edits` {"floor": true} puts one below it, as its recipe does.'
        )


def _what_helps(model: mujoco.MjModel) -> str:
    """The first change under which it is stable, by trying them."""
    for words, change in _REMEDIES:
        changed = copy.copy(model)
        change(changed)
        fall = let_go(changed)
        if fall.stable and not fall.is_thrown:
            return f"{words} helps."
    slips = next(slippery_contacts(model), None)
    if slips:
        return f"{slips.partition(':')[0]}; give them friction, or `condim` 1."
    tried = ", ".join(words for words, _ in _REMEDIES)
    return f"none of {tried} helps; look at its masses, its gains and what overlaps at its start."


def _implicitfast(model: mujoco.MjModel) -> None:
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST


def _elliptic(model: mujoco.MjModel) -> None:
    model.opt.cone = mujoco.mjtCone.mjCONE_ELLIPTIC


def _halved(model: mujoco.MjModel) -> None:
    model.opt.timestep /= 2


def _quartered(model: mujoco.MjModel) -> None:
    model.opt.timestep /= 4


_REMEDIES: tuple[tuple[str, Callable[[mujoco.MjModel], None]], ...] = (
    ('`integrator="implicitfast"`', _implicitfast),
    ('`cone="elliptic"`', _elliptic),
    ("half of its `timestep`", _halved),
    ("a quarter of its `timestep`", _quartered),
)


def _place(model: mujoco.MjModel, qpos: NDArray[np.float64]) -> NDArray[np.float64]:
    """The root's place in the world, [3] in m."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    return np.array(data.xpos[root_of(model)])
