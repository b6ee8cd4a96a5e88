"""Actuators: forces on joints and tendons, and activations.

Source: MuJoCo's documentation, Computation, "Actuation model".
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from math import exp

import mujoco
import numpy as np

from mujoco_compiled.fields import NOMINAL, Fields, Own, is_zero
from mujoco_compiled.program.arithmetic import Number, Vector, absolute, clip, maximum, select, total
from mujoco_compiled.smooth.delays import Late, read_late
from mujoco_compiled.smooth.muscles import (
    Muscle,
    MuscleDynamics,
    activation_rate,
    active_force,
    passive_force,
    read_muscle,
)
from mujoco_compiled.smooth.paths import Linear, Path, Posture, Slope, Stretch, stretch
from mujoco_compiled.smooth.sites import AtSite, ByCrank, crank_stretch, read_site_path, site_stretch
from mujoco_compiled.smooth.tendons import path_of, read_tendons
from mujoco_compiled.smooth.tree import Range, Tree


@dataclass(frozen=True)
class Adhesion:
    """Against the normals of a body's contacts, on average; MuJoCo gives it no gear. geoms: the body's."""

    geoms: tuple[int, ...]


ActuatorPath = Path | AtSite | ByCrank | Adhesion


@dataclass(frozen=True)
class ActivationConstants:
    """address: in act. share: of the way to the control that a filter goes in a timestep; None: an integrator
    of the control, or a muscle. early: the force follows the activation after the timestep."""

    address: int
    share: Number | None
    muscle: MuscleDynamics | None
    range: Range | None
    early: bool


@dataclass(frozen=True)
class BoundedTendon:
    """number: of the tendon. range: of the sum of its actuators' forces, in N."""

    number: int
    range: Range


@dataclass(frozen=True)
class ActuatorConstants:
    """A force along a length: gain · (control or activation) + bias.

    gain, bias: three coefficients each, of 1, of the length and of its rate, or a muscle's. control_range,
    force_range: None without bounds. late: None without a delay. tendon: that bounds the forces of all of
    its actuators together.
    """

    path: ActuatorPath
    gain: Vector | Muscle
    bias: Vector | Muscle
    activation: ActivationConstants | None
    control_range: Range | None
    force_range: Range | None
    late: Late | None
    tendon: BoundedTendon | None


@dataclass(frozen=True)
class Driven:
    """forces: the actuators' own [nu]. on_dofs: on the degrees of freedom [nv], MuJoCo's `qfrc_actuator`.

    act: the activations [na] after the timestep. slopes: of the actuators' forces. history: the controls for
    actuators that act late, after the timestep.
    """

    forces: Vector
    on_dofs: Vector
    act: Vector
    slopes: list[Slope]
    history: Vector


@dataclass(frozen=True)
class ActuatorState:
    """stretches: of the actuators' paths. qvel: [nv]. act: [na]. ctrl: [nu]. held: [nv], of gravity
    compensation; empty without. history: of controls, for actuators that act late; see `delays`."""

    stretches: Sequence[Stretch]
    qvel: Vector
    act: Vector
    ctrl: Vector
    held: Vector
    history: Vector = field(default_factory=list[Number])


def read_actuators(model: mujoco.MjModel, own: Own = NOMINAL) -> tuple[ActuatorConstants, ...]:
    """The model's actuators, on joints and tendons; none where actuation is disabled.

    own: see `Fields`.
    """
    fields = Fields(model, own)
    if fields.disables(mujoco.mjtDisableBit.mjDSBL_ACTUATION):
        return ()
    late = read_late(model)
    return tuple(_actuator(fields, number, late.get(number)) for number in range(model.nactuator))


def actuator_stretch(
    path: ActuatorPath, posture: Posture, pulled: Callable[[Adhesion], Vector] | None = None
) -> Stretch:
    """Of what an actuator acts along. posture: with the tendons' stretches. pulled: how an adhesion of 1 N
    acts on the degrees of freedom [nv]; None: nothing touches."""
    match path:
        case Adhesion():
            return Stretch(0.0, dict(enumerate(pulled(path) if pulled else [])))
        case AtSite():
            return site_stretch(path, posture)
        case ByCrank():
            return crank_stretch(path, posture)
        case _:
            return stretch(path, posture.qpos, posture.tendons)


def driven(
    tree: Tree, actuators: tuple[ActuatorConstants, ...], state: ActuatorState, timestep: float
) -> Driven:
    """The actuators in a timestep."""
    forces: Vector = [0.0] * len(actuators)
    found = Driven(forces, [0.0] * len(state.qvel), list(state.act), [], list(state.history))
    if not actuators:
        return found
    bounded: dict[BoundedTendon, list[_Pull]] = {}
    for number, (actuator, control) in enumerate(zip(actuators, state.ctrl, strict=True)):
        pull = _pull(actuator, number, control, state, timestep, found)
        if actuator.tendon is None:
            _apply(pull, found)
        else:
            bounded.setdefault(actuator.tendon, []).append(pull)
    for tendon, pulls in bounded.items():
        share = _share_left([pull.force for pull in pulls], tendon.range)
        for pull in pulls:
            _apply(replace(pull, force=pull.force * share), found)
    for i, dof in enumerate(tree.dofs):
        if dof.holds_weight and state.held:
            found.on_dofs[i] = found.on_dofs[i] + state.held[i]
        if dof.actuator_range:
            found.on_dofs[i] = clip(found.on_dofs[i], *dof.actuator_range)
    return found


@dataclass(frozen=True)
class _Pull:
    """What an actuator does before its own bounds. slope: how the force changes with the rate."""

    actuator: ActuatorConstants
    number: int
    stretched: Stretch
    force: Number
    slope: Number


def _pull(
    actuator: ActuatorConstants,
    number: int,
    control: Number,
    state: ActuatorState,
    timestep: float,
    found: Driven,
) -> _Pull:
    """Puts the activation and the control to what was found (changed)."""
    stretched = state.stretches[number]
    length, rate = stretched.length, stretched.rate(state.qvel)
    if actuator.late is not None:
        actuator.late.remember(found.history, control)
        control = actuator.late.control(state.history)
    wanted = clip(control, *actuator.control_range) if actuator.control_range else control
    if activation := actuator.activation:
        before = state.act[activation.address]
        after = _activated(activation, before, wanted, timestep)
        found.act[activation.address] = after
        wanted = after if activation.early else before
    gain, gain_slope = (
        active_force(actuator.gain, length, rate)
        if isinstance(actuator.gain, Muscle)
        else _affine(actuator.gain, length, rate)
    )
    bias, bias_slope = (
        (passive_force(actuator.bias, length), 0.0)
        if isinstance(actuator.bias, Muscle)
        else _affine(actuator.bias, length, rate)
    )
    force, slope = gain * wanted + bias, bias_slope + gain_slope * wanted
    return _Pull(actuator, number, stretched, force, slope)


def _share_left(forces: Vector, bounds: Range) -> Number:
    """What is left of each force where their sum is beyond bounds."""
    whole, (low, high) = total(forces), bounds
    inverse = 1.0 / select(absolute(whole) > 0.0, whole, 1.0)
    return select(whole < low, low * inverse, select(high < whole, high * inverse, 1.0))


def _apply(pull: _Pull, found: Driven) -> None:
    """Adds the force (changed)."""
    force, slope = pull.force, pull.slope
    if pull.actuator.force_range:
        low, high = pull.actuator.force_range
        if not is_zero(slope):
            slope = select((low < force) & (force < high), slope, 0.0)
        force = clip(force, low, high)
    found.forces[pull.number] = force
    found.slopes.append((pull.stretched, slope))
    for dof, coefficient in pull.stretched.moment.items():
        found.on_dofs[dof] = found.on_dofs[dof] + coefficient * force


def _activated(activation: ActivationConstants, before: Number, control: Number, timestep: float) -> Number:
    """The activation after the timestep."""
    if activation.muscle is not None:
        after = before + timestep * activation_rate(activation.muscle, before, control)
    elif activation.share is None:
        after = before + timestep * control
    else:
        after = before + activation.share * (control - before)
    return clip(after, *activation.range) if activation.range else after


def _affine(coefficients: Vector, length: Number, rate: Number) -> tuple[Number, Number]:
    """The value, and how it changes with the rate."""
    constant, of_length, of_rate = coefficients
    return constant + of_length * length + of_rate * rate, of_rate


def _actuator(fields: Fields, number: int, late: Late | None) -> ActuatorConstants:
    model = fields.model
    clamps = not fields.disables(mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL)
    limits_control = clamps and bool(model.actuator_ctrllimited[number])
    low, high = fields.row("actuator_forcerange", number)
    return ActuatorConstants(
        path=transmission(fields, number),
        gain=_gain(fields, number),
        bias=_bias(fields, number),
        activation=_activation(fields, number) if model.actuator_actadr[number] >= 0 else None,
        control_range=_range(model.actuator_ctrlrange[number]) if limits_control else None,
        force_range=(low, high) if model.actuator_forcelimited[number] else None,
        late=late,
        tendon=_bounded_tendon(model, number),
    )


def _bounded_tendon(model: mujoco.MjModel, actuator: int) -> BoundedTendon | None:
    tendon = int(model.actuator_trnid[actuator, 0])
    is_bounded = model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_TENDON and bool(
        model.tendon_actfrclimited[tendon]
    )
    return BoundedTendon(tendon, _range(model.tendon_actfrcrange[tendon])) if is_bounded else None


def _gain(fields: Fields, number: int) -> Vector | Muscle:
    kinds, kind = mujoco.mjtGain, fields.model.actuator_gaintype[number]
    if kind == kinds.mjGAIN_MUSCLE:
        return read_muscle(fields, number, "actuator_gainprm")
    gain = fields.row("actuator_gainprm", number)
    return gain[:3] if kind == kinds.mjGAIN_AFFINE else [gain[0], 0.0, 0.0]


def _bias(fields: Fields, number: int) -> Vector | Muscle:
    kinds, kind = mujoco.mjtBias, fields.model.actuator_biastype[number]
    if kind == kinds.mjBIAS_MUSCLE:
        return read_muscle(fields, number, "actuator_biasprm")
    return fields.row("actuator_biasprm", number)[:3] if kind == kinds.mjBIAS_AFFINE else [0.0] * 3


def transmission(fields: Fields, number: int) -> ActuatorPath:
    """What an actuator acts along."""
    model, target = fields.model, int(fields.model.actuator_trnid[number, 0])
    if np.isin(model.actuator_trntype[number], (mujoco.mjtTrn.mjTRN_SITE, mujoco.mjtTrn.mjTRN_SLIDERCRANK)):
        return read_site_path(fields, number)
    if model.actuator_trntype[number] == mujoco.mjtTrn.mjTRN_BODY:
        return Adhesion(tuple(np.flatnonzero(model.geom_bodyid == target).tolist()))
    gear = fields.row("actuator_gear", number)
    if model.actuator_trntype[number] == mujoco.mjtTrn.mjTRN_TENDON:
        return path_of(read_tendons(model, fields.own)[target], target, gear[0])
    dof = int(model.jnt_dofadr[target])
    num_dofs = int(np.count_nonzero(model.dof_jntid == target))
    moment = {dof + axis: x for axis, x in enumerate(gear[:num_dofs]) if not is_zero(x)}
    return Linear({int(model.jnt_qposadr[target]): gear[0]} if num_dofs == 1 else {}, moment)


def _activation(fields: Fields, number: int) -> ActivationConstants:
    model, dynamics = fields.model, mujoco.mjtDyn
    timestep = float(model.opt.timestep)
    time_constant = fields.number("actuator_dynprm", number)
    share: Number | None = None
    muscle: MuscleDynamics | None = None
    if model.actuator_dyntype[number] == dynamics.mjDYN_FILTER:
        share = timestep / maximum(time_constant, mujoco.mjMINVAL)
    elif model.actuator_dyntype[number] == dynamics.mjDYN_FILTEREXACT:
        share = 1.0 - exp(-timestep / max(time_constant, mujoco.mjMINVAL))
    elif model.actuator_dyntype[number] == dynamics.mjDYN_MUSCLE:
        muscle = MuscleDynamics(*fields.row("actuator_dynprm", number)[:3])
    return ActivationConstants(
        address=int(model.actuator_actadr[number]),
        share=share,
        muscle=muscle,
        range=_range(model.actuator_actrange[number]) if model.actuator_actlimited[number] else None,
        early=bool(model.actuator_actearly[number]),
    )


def _range(bounds: np.ndarray) -> Range:
    return float(bounds[0]), float(bounds[1])
