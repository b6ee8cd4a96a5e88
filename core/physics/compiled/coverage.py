"""What a model has that the stages do not compute, found before any code is made."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import mujoco
import numpy as np

from core.physics.compiled.collisions.table import COLLIDERS
from core.physics.compiled.constraints import read_constraints
from core.physics.compiled.pairs import read_pairs
from core.physics.compiled.softness import is_computable

_DISABLE, _ENABLE = mujoco.mjtDisableBit, mujoco.mjtEnableBit
# Switches that the stages follow, and those that change nothing that they compute.
_FOLLOWED = _DISABLE.mjDSBL_EULERDAMP | _DISABLE.mjDSBL_FILTERPARENT
_WITHOUT_EFFECT = (
    _DISABLE.mjDSBL_SENSOR
    | _DISABLE.mjDSBL_MIDPHASE
    | _DISABLE.mjDSBL_AUTORESET
    | _DISABLE.mjDSBL_NATIVECCD
    | _DISABLE.mjDSBL_ISLAND
    | _DISABLE.mjDSBL_MULTICCD
)
_ENABLED_WITHOUT_EFFECT = _ENABLE.mjENBL_ENERGY | _ENABLE.mjENBL_FWDINV


# Every row is code of its own, which is compiled, and run for all environments, whether it is active or not.
MOST_ROWS = 1000


def uncovered(model: mujoco.MjModel) -> str | None:
    """The first reason why the stages cannot move the model, such as "its geom 'rock' is a mesh"; None: they
    can."""
    return next((reason for check in _CHECKS for reason in check(model)), None)


def _options(model: mujoco.MjModel) -> Iterator[str]:
    option = model.opt
    if option.integrator != mujoco.mjtIntegrator.mjINT_EULER:
        yield f"its integrator is {_word(mujoco.mjtIntegrator(option.integrator).name)}"
    if option.solver == mujoco.mjtSolver.mjSOL_PGS:
        yield "its solver is PGS"
    if option.noslip_iterations:
        yield "it asks for the noslip solver"
    if option.density or option.viscosity:
        yield "it moves in a fluid (`density`, `viscosity`)"
    for bit in _DISABLE.__members__.values():
        if option.disableflags & bit & ~(_FOLLOWED | _WITHOUT_EFFECT):
            yield f"it disables a part of MuJoCo ({_word(bit.name)})"
    for bit in _ENABLE.__members__.values():
        if option.enableflags & bit & ~_ENABLED_WITHOUT_EFFECT:
            yield f"it enables a part of MuJoCo ({_word(bit.name)})"


def _parts(model: mujoco.MjModel) -> Iterator[str]:
    """Kinds of parts of which the stages know none."""
    if model.neq:
        yield f"its equality {_named(model, 'equality', 0)} ties bodies or joints together"
    if model.ntendon:
        yield f"it has a tendon, {_named(model, 'tendon', 0)}"
    if model.nflex:
        yield f"it has a flexible body, {_named(model, 'flex', 0)}"
    if model.nmocap:
        yield "it has a mocap body"
    if model.nplugin:
        yield "it uses a plugin"
    if model.na:
        yield "an actuator of it has an activation"


def _joints(model: mujoco.MjModel) -> Iterator[str]:
    joint_type = mujoco.mjtJoint
    rotates = np.isin(model.jnt_type, (joint_type.mjJNT_FREE, joint_type.mjJNT_BALL))
    yield from _where(model, "joint", rotates & (model.jnt_stiffness != 0), "is a spring in three dimensions")
    yield from _where(model, "joint", model.jnt_actfrclimited, "limits its actuators' forces")
    yield from _where(model, "joint", model.jnt_stiffnesspoly.any(axis=-1), "is not a linear spring")
    joint_of = model.dof_jntid
    yield from _where(model, "joint", model.dof_dampingpoly.any(axis=-1), "is not a linear damper", joint_of)
    rough = (model.dof_frictionloss != 0) & _uncomputable(model.dof_solimp)
    yield from _where(model, "joint", rough, _CURVE, joint_of)
    limited = model.jnt_limited != 0
    yield from _where(model, "joint", limited & _uncomputable(model.jnt_solimp), _CURVE)
    both_ends = limited & ~rotates & (np.ptp(model.jnt_range, axis=1) < 2.0 * model.jnt_margin)
    yield from _where(model, "joint", both_ends, "can be at both ends of its range at once")


def _bodies(model: mujoco.MjModel) -> Iterator[str]:
    yield from _where(model, "body", model.body_gravcomp, "has gravity compensation")


def _actuators(model: mujoco.MjModel) -> Iterator[str]:
    if not model.nactuator:
        return
    on_joints = np.isin(
        model.actuator_trntype, (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
    )
    yield from _where(model, "actuator", ~on_joints, "does not act on a joint")
    single = {int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE)}
    has_more = [
        bool(on) and int(model.jnt_type[joint]) not in single
        for on, joint in zip(on_joints, model.actuator_trnid[:, 0], strict=True)
    ]
    yield from _where(model, "actuator", np.array(has_more, bool), "acts on a joint with several axes")
    gain, bias = mujoco.mjtGain, mujoco.mjtBias
    simple = np.isin(model.actuator_gaintype, (gain.mjGAIN_FIXED, gain.mjGAIN_AFFINE)) & np.isin(
        model.actuator_biastype, (bias.mjBIAS_NONE, bias.mjBIAS_AFFINE)
    )
    yield from _where(model, "actuator", ~simple, "is a muscle, a motor with dynamics or a user's own kind")
    yield from _where(model, "actuator", model.actuator_delay > 0, "acts with a delay")
    for field in ("armature", "damping", "dampingpoly"):
        values = np.reshape(getattr(model, f"actuator_{field}"), (model.nactuator, -1))
        yield from _where(model, "actuator", values.any(axis=1), f"has `{field}` of its own")


def _contacts(model: mujoco.MjModel) -> Iterator[str]:
    for pair in read_pairs(model):
        both = [pair.one, pair.other]
        one, other = (_named(model, "geom", number) for number in both)
        names = f"its geoms {one} and {other} can touch"
        kinds = [int(kind) for kind in model.geom_type[both]]
        if (kinds[0], kinds[1]) not in COLLIDERS:
            first, second = (_word(mujoco.mjtGeom(kind).name) for kind in kinds)
            yield f"{names}: a {first} and a {second}"
        elif not is_computable(pair.parameters.softness.impedance.power):
            yield f"{names}: its contact {_CURVE}"
        elif model.geom_adhesion[both].any() or model.geom_surfacevel[both].any():
            yield f"{names} with adhesion or a moving surface"
    for place in np.flatnonzero(model.pair_adhesion)[:1]:
        yield f"its pair {_named(model, 'pair', int(place))} has adhesion"


def _rows(model: mujoco.MjModel) -> Iterator[str]:
    """Last, as it reads the constraints, which other checks must have let pass."""
    num_rows = read_constraints(model).num_rows
    if num_rows > MOST_ROWS:
        yield f"it can have {num_rows} constraint rows at once, more than {MOST_ROWS}"


_CHECKS: Sequence[Callable[[mujoco.MjModel], Iterator[str]]] = (
    _options, _parts, _joints, _bodies, _actuators, _contacts, _rows,
)  # fmt: skip
_CURVE = "has a `solimp` whose power is not a multiple of a half"


def _uncomputable(solimp: np.ndarray) -> np.ndarray:
    """[n]: where the stages have no operation for the curve of a `solimp` [n, 5]."""
    return np.array([not is_computable(power) for power in solimp[:, 4]], bool)


def _where(
    model: mujoco.MjModel, kind: str, found: Any, words: str, numbers: np.ndarray | None = None
) -> Iterator[str]:
    """The first element for which `found` is true. numbers: the elements' own, if not their places."""
    for place in np.flatnonzero(found)[:1]:
        yield f"its {kind} {_named(model, kind, int(place if numbers is None else numbers[place]))} {words}"


def _named(model: mujoco.MjModel, kind: str, number: int) -> str:
    name = mujoco.mj_id2name(model, getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}"), number)
    return f"'{name}'" if name else f"number {number}"


def _word(member: str) -> str:
    """The last part of an enumeration's name, as a model's XML has it."""
    return member.rsplit("_", 1)[-1].lower()
