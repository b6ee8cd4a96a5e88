"""Springs, dampers and actuators.

Source: MuJoCo's documentation, Computation, "Passive forces" and "Actuation model".
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from core.physics.compiled.arithmetic import Number, Vector, clip
from core.physics.compiled.tree import Tree

Range = tuple[float, float]


@dataclass(frozen=True)
class Actuator:
    """A force on one hinge or slide: (gain · control + bias) · gear.

    gain, bias: three coefficients each, of 1, of the length and of its rate, which are the joint's position
    and speed times the gear. qpos, dof: the joint's addresses. control_range, force_range: None without
    bounds.
    """

    qpos: int
    dof: int
    gear: float
    gain: Vector
    bias: Vector
    control_range: Range | None
    force_range: Range | None


def read_actuators(model: mujoco.MjModel) -> tuple[Actuator, ...]:
    """The model's actuators, which must be on hinges and slides, and without activations."""
    return tuple(_actuator(model, number) for number in range(model.nu))


def passive_forces(tree: Tree, qpos: Vector, qvel: Vector) -> Vector:
    """[nv]: MuJoCo's `qfrc_passive`, of springs on hinges and slides, and of dampers."""
    found: Vector = [-dof.damping * speed for dof, speed in zip(tree.dofs, qvel, strict=True)]
    for body in tree.bodies:
        for joint in body.joints:
            if joint.stiffness:
                stretch = qpos[joint.qpos] - joint.spring[0]
                found[joint.dof] = found[joint.dof] - joint.stiffness * stretch
    return found


def actuator_forces(
    actuators: tuple[Actuator, ...], qpos: Vector, qvel: Vector, ctrl: Vector
) -> tuple[Vector, Vector]:
    """The actuators' own forces [nu], and those on the degrees of freedom [nv], MuJoCo's `qfrc_actuator`."""
    own, found = list[Number](), [0.0] * len(qvel)
    for actuator, control in zip(actuators, ctrl, strict=True):
        length, rate = actuator.gear * qpos[actuator.qpos], actuator.gear * qvel[actuator.dof]
        wanted = clip(control, *actuator.control_range) if actuator.control_range else control
        force = _affine(actuator.gain, length, rate) * wanted + _affine(actuator.bias, length, rate)
        if actuator.force_range:
            force = clip(force, *actuator.force_range)
        own.append(force)
        found[actuator.dof] = found[actuator.dof] + actuator.gear * force
    return own, found


def _affine(coefficients: Vector, length: Number, rate: Number) -> Number:
    constant, of_length, of_rate = coefficients
    value: Number = constant
    if of_length:
        value = value + of_length * length
    if of_rate:
        value = value + of_rate * rate
    return value


def _actuator(model: mujoco.MjModel, number: int) -> Actuator:
    joint = int(model.actuator_trnid[number, 0])
    affine_gain = model.actuator_gaintype[number] == mujoco.mjtGain.mjGAIN_AFFINE
    affine_bias = model.actuator_biastype[number] == mujoco.mjtBias.mjBIAS_AFFINE
    gain, bias = model.actuator_gainprm[number], model.actuator_biasprm[number]
    return Actuator(
        qpos=int(model.jnt_qposadr[joint]),
        dof=int(model.jnt_dofadr[joint]),
        gear=float(model.actuator_gear[number, 0]),
        gain=[float(gain[0]), *(float(x) for x in (gain[1:3] if affine_gain else np.zeros(2)))],
        bias=[float(x) for x in (bias[:3] if affine_bias else np.zeros(3))],
        control_range=_range(model.actuator_ctrllimited[number], model.actuator_ctrlrange[number]),
        force_range=_range(model.actuator_forcelimited[number], model.actuator_forcerange[number]),
    )


def _range(limited: int, bounds: np.ndarray) -> Range | None:
    return (float(bounds[0]), float(bounds[1])) if limited else None
