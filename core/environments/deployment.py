"""A task as a robot runs it: what it measures, what its policy sees of that, and what its servos get."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import mujoco
import numpy as np

from core.environments.terms.actuation import Actuation
from core.environments.terms.commands import AnyCommand, GaitClock
from core.environments.terms.inventory import ModelParts
from core.environments.terms.observations import ObservationTerm
from core.environments.terms.sensed import Sensed
from core.environments.terms.step import ModelIndex
from core.environments.terms.task import TaskOptions, observed


class NotDeployed(Exception):
    """The task has no form for robots. The sentence says why."""


@dataclass(frozen=True)
class SeenTerm:
    """A term of the policy's observation: what is measured, times `scale`, within ± `clip`, [size]; and the
    same of steps before, `history` of them in all, the oldest first."""

    kind: str
    size: int
    scale: float
    clip: float | None
    history: int
    sensed: Sensed


@dataclass(frozen=True)
class Joint:
    """A hinge or slide. default: its position in the pose. stiffness, damping, effort: of its servo, in
    N m/rad, N m s/rad and N m; effort is None without a limit, and all are None where nothing drives it.
    armature, friction_loss, joint_damping: of the joint without it, in kg m², N m and N m s/rad. These units
    are those of a hinge; of a slide they are N, m and kg. target: what its servo gets, None where nothing
    drives it.
    """

    name: str
    default: float
    stiffness: float | None
    damping: float | None
    effort: float | None
    armature: float
    friction_loss: float
    joint_damping: float
    target: Literal["position", "velocity", "effort"] | None


@dataclass(frozen=True)
class Deployment:
    """joints: in the model's order. acting: the joint of each servo, by number, [nu]. actuators: the servos
    that an action moves, by number, in its order; for the others it is 0. smoothing: the share of
    the last action in the next. offset, scale: [nu], a joint's target is offset + scale · action, in rad,
    rad/s or N m, of slides m, m/s or N, and within the servo's `bounds` where it has some.

    qpos: where an episode begins, [nq]. physics_step_s, integrator: those of the training.
    """

    terms: Sequence[SeenTerm]
    joints: Sequence[Joint]
    acting: Sequence[int]
    actuators: Sequence[int]
    smoothing: float
    offset: Sequence[float]
    scale: Sequence[float]
    bounds: Sequence[tuple[float, float] | None]
    command: AnyCommand | None
    gait: GaitClock | None
    qpos: Sequence[float]
    physics_step_s: float
    integrator: str

    def document(self) -> dict[str, Any]:
        """The contract's part on robots, as JSON (docs/export.md)."""
        return {
            "joints": [asdict(joint) for joint in self.joints],
            "action": {
                "joints": [self.joints[number].name for number in self.acting],
                "actuators": list(self.actuators),
                "smoothing": self.smoothing,
                "offset": list(self.offset),
                "scale": list(self.scale),
                "bounds": list(self.bounds),
            },
            "terms": [
                {
                    "kind": term.kind,
                    "size": term.size,
                    "scale": term.scale,
                    "clip": term.clip,
                    "history": term.history,
                }
                for term in self.terms
            ],
            "command": None if self.command is None else self.command.model_dump(mode="json"),
            "gait": None if self.gait is None else self.gait.model_dump(mode="json"),
            "qpos": list(self.qpos),
            "physics_step_s": self.physics_step_s,
            "integrator": self.integrator,
        }


def deployment(
    options: TaskOptions, index: ModelIndex, parts: ModelParts, actuation: Actuation | None
) -> Deployment:
    """The task under these options. actuation: what actions become. Raises NotDeployed."""
    if actuation is None:
        raise NotDeployed("its actions are no targets of joints, as those of `joint_position` are")
    model, joints = index.model, index.joints(None).tolist()
    driven = model.actuator_trnid[:, 0].tolist()
    return Deployment(
        terms=[_seen(term, index, parts) for term in observed(options)],
        joints=[_joint(model, joint, driven, index.pose, actuation) for joint in joints],
        acting=[joints.index(joint) for joint in driven],
        actuators=actuation.actuators.tolist(),
        smoothing=options.action.smoothing,
        offset=actuation.offset.astype(float).tolist(),
        scale=(actuation.gain.astype(float) * actuation.per_control).tolist(),
        bounds=[_bounds(model, number, actuation.per_control[number]) for number in range(model.nu)],
        command=options.command,
        gait=options.gait,
        qpos=index.pose.tolist(),
        physics_step_s=float(model.opt.timestep),
        integrator=mujoco.mjtIntegrator(model.opt.integrator).name.removeprefix("mjINT_").lower(),
    )


def _seen(term: ObservationTerm, index: ModelIndex, parts: ModelParts) -> SeenTerm:
    return SeenTerm(
        kind=term.label,
        size=sum(part.size for part in term.slices(parts)),
        scale=term.scale,
        clip=term.clip,
        history=term.history,
        sensed=term.sensed(index, parts),
    )


def _bounds(model: mujoco.MjModel, servo: int, per_control: float) -> tuple[float, float] | None:
    low, high = sorted((model.actuator_ctrlrange[servo] * per_control).tolist())
    return (low, high) if model.actuator_ctrllimited[servo] else None


def _joint(
    model: mujoco.MjModel, number: int, driven: Sequence[int], pose: np.ndarray, actuation: Actuation
) -> Joint:
    servo = driven.index(number) if number in driven else None
    dof = int(model.jnt_dofadr[number])
    kind = None if servo is None else actuation.kinds[servo]
    limited = servo is not None and bool(model.actuator_forcelimited[servo])
    return Joint(
        name=model.joint(number).name,
        default=float(pose[model.jnt_qposadr[number]]),
        stiffness=None if servo is None else float(model.actuator_gainprm[servo, 0] * (kind == "position")),
        damping=None if servo is None else -float(model.actuator_biasprm[servo, 2]),
        effort=float(model.actuator_forcerange[servo, 1]) if limited else None,
        armature=float(model.dof_armature[dof]),
        friction_loss=float(model.dof_frictionloss[dof]),
        joint_damping=float(np.ravel(model.dof_damping[dof])[0]),
        target="effort" if kind == "motor" else kind,
    )
