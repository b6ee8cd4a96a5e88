"""The actuators of a compiled model: of which kind each is, and the controls that an action gives them."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from core.environments.terms.actions import EffortPart, JointAction, JointPart, PositionPart, VelocityPart
from core.environments.terms.inventory import ActuatorKind
from core.errors import JobFailed
from core.patterns import by_name
from core.reasons import Reason

_ON_A_JOINT = int(mujoco.mjtTrn.mjTRN_JOINT)
_FIXED_GAIN = int(mujoco.mjtGain.mjGAIN_FIXED)
# A custom numeric of the model for each joint whose motor's speed is limited: see `add_motor`.
_MOTOR = "gaitway:motor:"


@dataclass(frozen=True)
class Actuation:
    """The controls of a joint action: offset + gain · action of its actuators, and the offset of the others.

    actuators: numbers of those that are acted on, [actions]. offset, gain: [nu]. kinds: [nu]. per_control:
    what a control of 1 asks of the joint, [nu], in rad, rad/s or N m.
    """

    actuators: np.ndarray
    offset: np.ndarray
    gain: np.ndarray
    kinds: Sequence[ActuatorKind]
    per_control: np.ndarray


def actuation(action: JointAction, model: mujoco.MjModel, pose: np.ndarray) -> Actuation:
    """How the action becomes controls. pose: positions [nq] that joints keep.

    Raises JobFailed("bad_model") where an actuator is not of the action's kind, and where one that is not
    acted on cannot keep the pose.
    """
    parts, joints = action.parts, joint_names(model)
    driving = [next((place for place, part in enumerate(parts) if part.drives(one)), -1) for one in joints]
    kinds: list[ActuatorKind] = ["position" if place < 0 else parts[place].actuator for place in driving]
    for number, (place, kind) in enumerate(zip(driving, kinds, strict=True)):
        if kind_of(model, number) != kind:
            part = parts[place] if place >= 0 else None
            raise JobFailed(Reason.BAD_MODEL, _misfit(part, model.actuator(number).name))
    # The gain of a joint that no part drives is never used.
    gains = [_gain(part, model, joints) for part in parts]
    gain = np.stack(gains)[driving, np.arange(model.nu)]
    is_target = np.array([kind == "position" for kind in kinds], bool)
    rest = pose[model.jnt_qposadr[model.actuator_trnid[:, 0]]].astype(np.float32)
    return Actuation(
        np.flatnonzero(np.array(driving, int) >= 0),
        np.where(is_target, rest, np.float32(0.0)),
        gain.astype(np.float32),
        kinds,
        np.array([_per_control(kind, model)[number] for number, kind in enumerate(kinds)]),
    )


def _misfit(part: JointPart | None, name: str) -> str:
    if part is None:
        return (
            f"The actuator {name!r} is not acted on, and is no position servo that could keep the pose: give "
            "its joint one in `edits.servos`, or act on it."
        )
    return (
        f"The actuator {name!r} is no {part.what} of a joint, as the action {getattr(part, 'kind', '')} "
        "needs: give its joint one in `edits.servos`, or take the action `control`."
    )


def _gain(part: JointPart, model: mujoco.MjModel, joints: list[str]) -> np.ndarray:
    """The change of the controls [nu] that an action of 1 would make if the part drove all joints."""
    match part:
        case PositionPart():
            stiffness, forces = model.actuator_gainprm[:, 0], model.actuator_forcerange[:, 1]
            limited = model.actuator_forcelimited.astype(bool)
            own = np.where(limited, 0.5 * forces / np.maximum(stiffness, 1e-9), 0.25)
            return _scaled(part.scale, own, joints)
        case VelocityPart() | EffortPart():
            own = _own_scale(part, model)
            return _scaled(part.scale, own, joints) / _per_control(part.actuator, model)
        case _:
            raise TypeError(part)


def _scaled(wanted: float | dict[str, float] | None, own: np.ndarray, joints: list[str]) -> np.ndarray:
    """The scales [nu]: the wanted ones, and the actuators' own where nothing is said."""
    if isinstance(wanted, dict):
        chosen = by_name(wanted, joints)
        return np.array([chosen.get(name, scale) for name, scale in zip(joints, own, strict=True)])
    return own if wanted is None else np.full(len(own), wanted)


def _own_scale(part: VelocityPart | EffortPart, model: mujoco.MjModel) -> np.ndarray:
    """The greatest velocity or torque at the joints, [nu]; 1 where it is not known."""
    if isinstance(part, VelocityPart):
        limits = [motor_of(model, joint) for joint in joint_names(model)]
        return np.array([1.0 if limit is None else limit[0] for limit in limits])
    limited, force = model.actuator_forcelimited.astype(bool), model.actuator_forcerange[:, 1]
    gear = np.abs(model.actuator_gear[:, 0])
    by_control = np.where(
        model.actuator_ctrllimited.astype(bool),
        model.actuator_ctrlrange[:, 1] * np.abs(model.actuator_gainprm[:, 0]),
        np.inf,
    )
    most = np.minimum(np.where(limited, force, np.inf), by_control) * gear
    return np.where(np.isfinite(most), most, 1.0)


def _per_control(kind: ActuatorKind, model: mujoco.MjModel) -> np.ndarray:
    """The joints' positions, velocities or torques for a control of 1, [nu]."""
    gear = model.actuator_gear[:, 0]
    match kind:
        case "position":
            return np.ones(model.nu)
        case "velocity":
            return 1.0 / gear
        case "motor":
            return gear * model.actuator_gainprm[:, 0]


def kind_of(model: mujoco.MjModel, actuator: int) -> ActuatorKind | None:
    """None: it moves no joint, or in another way."""
    if model.actuator_trntype[actuator] != _ON_A_JOINT:
        return None
    _, of_position, of_velocity = model.actuator_biasprm[actuator, :3]
    if of_position < 0:
        return "position"
    if model.actuator_dyntype[actuator] or model.actuator_gaintype[actuator] != _FIXED_GAIN:
        return None
    if not model.actuator_biastype[actuator]:
        return "motor"
    return "velocity" if of_velocity < 0 and not of_position else None


def position_servos(model: mujoco.MjModel) -> np.ndarray:
    """[nu]: the actuators that hold a joint in a position."""
    return (model.actuator_trntype == _ON_A_JOINT) & (model.actuator_biasprm[:, 1] < 0)


def joint_names(model: mujoco.MjModel) -> list[str]:
    """Of the joint that each actuator moves; empty for one that moves something else."""
    return [
        model.joint(joint).name if kind == _ON_A_JOINT else ""
        for kind, joint in zip(model.actuator_trntype, model.actuator_trnid[:, 0], strict=True)
    ]


def add_motor(spec: mujoco.MjSpec, joint: str, velocity_limit: float, saturation_effort: float) -> None:
    """Let the model say what `TorqueSpeedCurve` needs to know of a joint's motor."""
    values = [velocity_limit, saturation_effort]
    spec.add_numeric(name=_MOTOR + joint, data=values, size=len(values))


def motor_of(model: mujoco.MjModel, joint: str) -> tuple[float, float] | None:
    """The velocity limit of the joint's motor, and its torque at rest if nothing else limited it."""
    place = mujoco.mj_name2id(model, int(mujoco.mjtObj.mjOBJ_NUMERIC), _MOTOR + joint)
    if place < 0:
        return None
    limit, effort = map(float, model.numeric(place).data)
    return limit, effort
