"""Whether servos hold a pose at the model's timestep, and where the pose is; in C MuJoCo, for moments."""

import copy
import time
from collections.abc import Iterator

import mujoco
import numpy as np

from core.environments.mjcf.edit_options import HOME, ModelEdits
from core.environments.mjcf.edits import clearance
from core.environments.terms.actuation import position_servos
from core.errors import Problem
from core.patterns import matching
from core.physics.model import initial_qpos

# A second of a coarse timestep. Gains that are too large for a timestep blow up with each step, so that more
# of them say nothing new.
_SECONDS, _MOST_STEPS = 1.0, 200
# rad or m. The difference of two motions that began so far apart is that of a linear system.
_APART = 1e-6
_GROWTH = 10.0
# Of kp: less would hold no robot.
_LEAST_SHARE = 1e-4
_BISECTIONS = 12
# For the servos as they are, and to find what holds; a model that is too slow for this is not judged.
_MOST_TIME_S, _MOST_TIME_OF_SEARCH_S = 1.0, 1.5
# A foot that is deeper in the floor is thrown out of it. MuJoCo's contacts themselves give some millimetres.
_DEEPEST_M = 0.01


def problems(model: mujoco.MjModel, edits: ModelEdits, pointer: str) -> Iterator[Problem]:
    """The problems of the pose and the servos of a model that these changes made. pointer: theirs."""
    qpos = model.key(HOME).qpos if edits.pose is not None else initial_qpos(model)
    if edits.pose is not None:
        yield from _under_the_floor(model, edits, qpos, pointer)
    if edits.servos:
        yield from _unstable(model, edits, qpos, pointer)


def _under_the_floor(
    model: mujoco.MjModel, edits: ModelEdits, qpos: np.ndarray, pointer: str
) -> Iterator[Problem]:
    distance = clearance(model, qpos)
    if distance is None or distance >= -_DEEPEST_M:
        return
    free = np.flatnonzero(model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE))
    if not free.size:
        yield Problem(f"{pointer}/pose", f"The pose is {-distance:.3g} m inside the floor.")
        return
    height = float(qpos[model.jnt_qposadr[free[0]] + 2])
    yield Problem(
        f"{pointer}/pose/height",
        f"At a height of {height:.3g} m the pose is {-distance:.3g} m inside the floor: it stands at "
        f"{height - distance:.3g}, or leave the height out.",
    )


def _unstable(model: mujoco.MjModel, edits: ModelEdits, qpos: np.ndarray, pointer: str) -> Iterator[Problem]:
    actuator = blows_up(model, qpos, until=time.monotonic() + _MOST_TIME_S)
    if actuator is None:
        return
    joint = model.joint(model.actuator_trnid[actuator, 0]).name
    place = next(number for number, servo in enumerate(edits.servos) if matching(servo.joints, [joint]))
    old_kp, old_kd = float(model.actuator_gainprm[actuator, 0]), -float(model.actuator_biasprm[actuator, 2])
    share = largest_stable(model, qpos)
    if share is None:
        hint = "no smaller kp with the same damping ratio helps: take a shorter timestep."
    else:
        kp = _rounded_down(old_kp * share, digits=2)
        kd = _rounded_down(old_kd * (kp / old_kp) ** 0.5, digits=3)
        hint = (
            f"the largest stable kp is {kp:g}, with a kd of {kd:g} for the same damping ratio; or take a "
            "shorter timestep."
        )
    yield Problem(
        f"{pointer}/servos/{place}/kp",
        f"The servo of the joint {joint!r} does not hold the pose at a timestep of "
        f"{model.opt.timestep:g} s, but blows up; {hint}",
    )


def blows_up(
    model: mujoco.MjModel, qpos: np.ndarray, share: float = 1.0, until: float = float("inf")
) -> int | None:
    """The servo whose joint swings most where servos, in the air and without friction, do not hold this pose;
    None if they hold it. share: of each kp, with the same damping ratio. until: by the monotonic clock.

    Two motions that begin close to each other are compared, so that springs and weights do not count.
    """
    alone = _without_surroundings(model, share)
    servos = np.flatnonzero(position_servos(model))
    addresses = model.jnt_qposadr[model.actuator_trnid[servos, 0]]
    dofs = model.jnt_dofadr[model.actuator_trnid[servos, 0]]
    one, other = mujoco.MjData(alone), mujoco.MjData(alone)
    for data in (one, other):
        data.qpos[:], data.ctrl[servos] = qpos, qpos[addresses]
    other.qpos[addresses] += _APART * np.random.default_rng(0).choice([-1.0, 1.0], servos.size)
    for _ in range(min(_MOST_STEPS, round(_SECONDS / model.opt.timestep))):
        if time.monotonic() > until:
            break
        mujoco.mj_step(alone, one)
        mujoco.mj_step(alone, other)
        apart = np.abs(other.qpos[addresses] - one.qpos[addresses])
        speeds = np.abs(other.qvel[dofs] - one.qvel[dofs]) * model.opt.timestep
        swing = np.maximum(apart, speeds)
        if not (swing.max(initial=0.0) < _GROWTH * _APART):
            return int(servos[np.nan_to_num(swing, nan=np.inf).argmax()])
    return None


def largest_stable(model: mujoco.MjModel, qpos: np.ndarray) -> float | None:
    """The largest share of each kp, with the same damping ratio, that holds the pose; None: none does. Less
    than that where finding it takes too long."""
    until = time.monotonic() + _MOST_TIME_OF_SEARCH_S
    low, high = _LEAST_SHARE, 1.0
    if blows_up(model, qpos, low, until) is not None:
        return None
    for _ in range(_BISECTIONS):
        middle = float(np.sqrt(low * high))
        bursts = blows_up(model, qpos, middle, until) is not None
        if time.monotonic() > until:
            break
        low, high = (low, middle) if bursts else (middle, high)
    return low


def _without_surroundings(model: mujoco.MjModel, share: float) -> mujoco.MjModel:
    """A copy in which nothing touches, weighs or rubs, with this share of each servo's kp."""
    alone, off = copy.copy(model), mujoco.mjtDisableBit
    surroundings = off.mjDSBL_CONTACT | off.mjDSBL_GRAVITY | off.mjDSBL_FRICTIONLOSS | off.mjDSBL_LIMIT
    alone.opt.disableflags |= int(surroundings | off.mjDSBL_AUTORESET)
    servos = position_servos(model)
    alone.actuator_gainprm[servos, 0] *= share
    alone.actuator_biasprm[servos, 1] *= share
    alone.actuator_biasprm[servos, 2] *= share**0.5
    return alone


def _rounded_down(value: float, digits: int) -> float:
    """Such as 41 of 41.9, so that what is said to be stable is so."""
    if not value:
        return 0.0
    scale = 10.0 ** (np.floor(np.log10(value)) + 1 - digits)
    return float(np.floor(value / scale) * scale)
