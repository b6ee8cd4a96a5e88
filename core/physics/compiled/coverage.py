"""What a model has that the stages do not compute, found before any code is made."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import mujoco
import numpy as np

from core.physics.compiled.pairs import touching_geoms

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


def uncovered(model: mujoco.MjModel) -> str | None:
    """The first reason why the stages cannot move the model, such as "its geom 'rock' is a mesh"; None: they
    can."""
    return next((reason for check in _CHECKS for reason in check(model)), None)


def _options(model: mujoco.MjModel) -> Iterator[str]:
    option = model.opt
    if option.integrator != mujoco.mjtIntegrator.mjINT_EULER:
        yield f"its integrator is {_word(mujoco.mjtIntegrator(option.integrator).name)}"
    if option.cone != mujoco.mjtCone.mjCONE_PYRAMIDAL:
        yield "its friction cones are elliptic"
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
    yield from _where(model, "joint", rotates & (model.jnt_limited != 0), "is a ball joint with a limit")
    yield from _where(model, "joint", model.jnt_actfrclimited, "limits its actuators' forces")
    yield from _where(model, "joint", model.jnt_stiffnesspoly.any(axis=-1), "is not a linear spring")
    joint_of = model.dof_jntid
    yield from _where(model, "joint", model.dof_dampingpoly.any(axis=-1), "is not a linear damper", joint_of)
    yield from _where(model, "joint", model.dof_frictionloss, "has friction loss", joint_of)
    limited = model.jnt_limited != 0
    yield from _where(model, "joint", limited & _unusual(model.jnt_solref, model.jnt_solimp), _SOFTNESS)


def _bodies(model: mujoco.MjModel) -> Iterator[str]:
    yield from _where(model, "body", model.body_gravcomp, "has gravity compensation")


def _actuators(model: mujoco.MjModel) -> Iterator[str]:
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
    kinds, plane = mujoco.mjtGeom, mujoco.mjtGeom.mjGEOM_PLANE
    on_planes = (kinds.mjGEOM_SPHERE, kinds.mjGEOM_CAPSULE)
    if model.npair:
        yield "it lists pairs of geoms that touch"
    for one, other in touching_geoms(model):
        names = f"its geoms {_named(model, 'geom', one)} and {_named(model, 'geom', other)} can touch"
        types = {int(model.geom_type[one]), int(model.geom_type[other])}
        if plane not in types:
            yield f"{names}, and neither is a plane"
        elif not types - {plane} <= set(on_planes):
            yield f"{names}: a {_word(kinds(max(types)).name)} and a plane"
        elif model.geom_condim[[one, other]].max() > 3:
            yield f"{names} with torsional or rolling friction"
        elif model.geom_priority[one] != model.geom_priority[other]:
            yield f"{names} and have different priorities"
        elif _unusual(model.geom_solref[[one, other]], model.geom_solimp[[one, other]]).any():
            yield f"{names}: {_SOFTNESS}"
        elif model.geom_adhesion[[one, other]].any() or model.geom_surfacevel[[one, other]].any():
            yield f"{names} with adhesion or a moving surface"


_CHECKS: Sequence[Callable[[mujoco.MjModel], Iterator[str]]] = (
    _options, _parts, _joints, _bodies, _actuators, _contacts,
)  # fmt: skip
_SOFTNESS = "has a `solref` of stiffness and damping, or a `solimp` with its own midpoint or power"


def _unusual(solref: np.ndarray, solimp: np.ndarray) -> np.ndarray:
    """[n]: where softness is not given as `constraints.Softness` reads it."""
    return (solref <= 0.0).any(axis=-1) | (solimp[:, 3:] != (0.5, 2.0)).any(axis=-1)


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
