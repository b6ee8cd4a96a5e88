"""An engine beside C MuJoCo: whether it moves a model, and reads its sensors, as C MuJoCo does.

Contacts make any two trajectories part soon. So the engine is set down in C MuJoCo's own state again and
again, and each difference is that of two control steps. Decision 21 says how the bounds were chosen.
"""

from collections.abc import Collection, Generator, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from numpy.typing import NDArray

from core.physics.engine import Engine, PhysicsState
from core.physics.model import in_parts, initial_qpos
from mujoco_compiled import ordered_history

# The part of the motion by which an engine may differ in half of the tries, and in nine of ten.
HALF_WITHIN, MOST_WITHIN = 1e-3, 0.1
_CONTROL_STEP_S, _STEPS_A_TRY, _TRIES_A_SECOND = 0.02, 2, 25
_FALL_S = 1.0
# Where all of C MuJoCo's own states burst under actions over the whole range, milder ones are taken.
_SHARES = (1.0, 0.1, 0.0)
# A number that hardly moves is measured by this part of the motion of all of its kind.
_LEAST_SHARE = 0.1
_CARRIED = ("qpos", "qvel", "act", "qacc_warmstart")
_COMPARED = ("qpos", "qvel", "act", "sensordata")
Arrays = Mapping[str, NDArray[np.float64]]


@dataclass(frozen=True)
class ReferenceMotion:
    """C MuJoCo's motion in short tries. begun, ended: its states by MuJoCo's names, [tries, n].

    ctrl: [tries, control steps, nu]. share: of the controls' ranges, from which they were drawn.
    """

    num_substeps: int
    share: float
    begun: Arrays
    ended: Arrays
    ctrl: NDArray[np.float64]

    @property
    def num_tries(self) -> int:
        return len(self.ctrl)


@dataclass(frozen=True)
class EngineDifference:
    """How far an engine is from C MuJoCo, in parts of the motion.

    Half of the tries differ by `half` at most, nine of ten by `most`. quantity: the field that differs most.
    broken: tries that ended as NaN.
    """

    quantity: str
    half: float
    most: float
    broken: int

    @property
    def is_right(self) -> bool:
        return not self.broken and self.half <= HALF_WITHIN and self.most <= MOST_WITHIN

    def words(self, num_tries: int) -> str:
        after = f"after {_STEPS_A_TRY * _CONTROL_STEP_S:g} s beside C MuJoCo"
        if self.broken:
            return f"{after} {self.broken} of {num_tries} states are not finite"
        return (
            f"{after} its {self.quantity} is off by {self.half:.1g} of the motion in half of the tries "
            f"(right: up to {HALF_WITHIN:g}) and by {self.most:.1g} in a tenth (right: up to {MOST_WITHIN:g})"
        )


def record(
    model: mujoco.MjModel, *, seed: int = 0, apart: Collection[tuple[int, int]] = ()
) -> ReferenceMotion | None:
    """A second from the model's start and a second after one of falling, under random controls.

    apart: numbers of geoms that pass through each other, as in an engine that leaves them out. None if C
    MuJoCo's own state bursts even without controls.
    """
    with passing(apart):
        return _record(model, seed)


@contextmanager
def passing(apart: Collection[tuple[int, int]]) -> Generator[None]:
    """Lets these geoms pass through each other in C MuJoCo, which asks this process's one filter about each
    pair."""
    if not apart:
        yield
        return
    pairs = {pair for one, other in apart for pair in ((one, other), (other, one))}
    mujoco.set_mjcb_contactfilter(lambda model, data, one, other: int((one, other) in pairs))
    try:
        yield
    finally:
        mujoco.set_mjcb_contactfilter(None)


def _record(model: mujoco.MjModel, seed: int) -> ReferenceMotion | None:
    for share in _SHARES:
        tries = list(_tries(model, share, np.random.default_rng(seed)))
        if len(tries) == 2 * _TRIES_A_SECOND:
            begun, ended, controls = zip(*tries, strict=True)
            return ReferenceMotion(
                _num_substeps(model), share, _stacked(begun), _stacked(ended), np.array(controls)
            )
    return None


def compare(engine: Engine, reference: ReferenceMotion) -> EngineDifference:
    """The engine's end of each try beside C MuJoCo's."""
    step = jax.jit(jax.vmap(engine.step))
    state = _set_down(engine, reference)
    for k in range(_STEPS_A_TRY):
        state = step(state, jnp.asarray(reference.ctrl[:, k], jnp.float32))
    found = {"qpos": state.qpos, "qvel": state.qvel, "act": state.act, **state.derived}
    compared = [name for name in _COMPARED if name in found and reference.ended[name].size]
    return max(
        (_difference(name, np.asarray(found[name], float), reference) for name in compared),
        key=lambda one: (one.broken, max(one.half / HALF_WITHIN, one.most / MOST_WITHIN)),
    )


def _difference(name: str, ours: NDArray[np.float64], reference: ReferenceMotion) -> EngineDifference:
    theirs = reference.ended[name]
    moved = theirs - reference.begun[name] if name == "qpos" else theirs
    size = np.abs(moved).max(axis=0)
    size = np.maximum(size, max(_LEAST_SHARE * float(size.max()), 1e-6))
    off = (np.abs(ours - theirs) / size).max(axis=1)
    broken = int(np.count_nonzero(~np.isfinite(off)))
    half, most = np.quantile(np.nan_to_num(off, nan=np.inf), (0.5, 0.9), method="lower")
    return EngineDifference(name, float(half), float(most), broken)


def _set_down(engine: Engine, reference: ReferenceMotion) -> PhysicsState:
    """C MuJoCo's states at the beginnings, as the engine's."""
    begun = {name: jnp.asarray(values, jnp.float32) for name, values in reference.begun.items()}
    state = jax.vmap(engine.reset)(begun["qpos"], begun["qvel"])
    exact = {name: jnp.asarray(in_parts(reference.begun[name])) for name in state.exact}
    return replace(
        state, act=begun["act"], qacc_warmstart=begun["qacc_warmstart"], time=begun["time"], exact=exact
    )


def _tries(
    model: mujoco.MjModel, share: float, random: np.random.Generator
) -> Iterator[tuple[Arrays, Arrays, NDArray[np.float64]]]:
    """Begin, end and controls of each; they stop where C MuJoCo's own state bursts."""
    limited = model.actuator_ctrllimited.astype(bool)
    low, high = np.where(limited, model.actuator_ctrlrange.T, [[-1.0], [1.0]])
    for fall_s in (0.0, _FALL_S):
        data = mujoco.MjData(model)
        data.qpos[:] = initial_qpos(model)
        mujoco.mj_step(model, data, round(fall_s / model.opt.timestep))
        for _ in range(_TRIES_A_SECOND):
            ctrl, begun = share * random.uniform(low, high, (_STEPS_A_TRY, model.nu)), _state(model, data)
            for one in ctrl:
                data.ctrl[:] = one
                mujoco.mj_step(model, data, _num_substeps(model))
            if any(warning.number for warning in data.warning):
                return
            yield begun, _state(model, data), ctrl


def _state(model: mujoco.MjModel, data: mujoco.MjData) -> Arrays:
    """Sensors are of this state, but for those of forces and accelerations (decision 4)."""
    fresh = mujoco.MjData(model)
    mujoco.mj_copyData(fresh, model, data)
    for stage in (mujoco.mj_fwdPosition, mujoco.mj_sensorPos, mujoco.mj_fwdVelocity, mujoco.mj_sensorVel):
        stage(model, fresh)
    carried = {name: np.array(getattr(data, name)) for name in (*_CARRIED, "time")}
    history = ordered_history(model, data.history)
    return {**carried, "history": history, "sensordata": np.array(fresh.sensordata)}


def _stacked(states: tuple[Arrays, ...]) -> Arrays:
    return {name: np.stack([one[name] for one in states]) for name in states[0]}


def _num_substeps(model: mujoco.MjModel) -> int:
    return max(1, round(_CONTROL_STEP_S / model.opt.timestep))
