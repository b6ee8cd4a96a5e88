"""Whether a task's action fits the actuators of the model."""

from collections.abc import Iterator, Sequence

from core.environments.terms.actions import JointAction, JointPart, MixedAction, PositionPart
from core.environments.terms.inventory import Inventory
from core.environments.terms.locomotion import JointPositions
from core.environments.terms.task import TaskOptions, observed
from core.environments.terms.unmatched import unmatched, unmatched_by
from core.errors import Problem

_JOINT = "hinge or slide"


def problems(options: TaskOptions, model: Inventory, here: str) -> Iterator[Problem]:
    """Actuators that are of another kind than the action, or cannot keep the pose, as far as it is known.

    here: the action's pointer.
    """
    action = options.action
    if action.torque_speed_curve and not any(actuator.velocity_limit for actuator in model.actuators):
        detail = "No servo has a velocity_limit and a greatest torque, so there is no torque-speed curve."
        yield Problem(f"{here}/torque_speed_curve", detail)
    if not isinstance(action, JointAction):
        return
    parts = _with_pointers(action, here)
    found = [problem for pointer, part in parts for problem in _of_part(part, pointer, model)]
    found = found or [*_of_overlap(parts, model), *_of_the_others(action, model, here)]
    yield from found
    reads_bias = any(isinstance(term, JointPositions) and term.bias for term in observed(options))
    for pointer, part in parts:
        if isinstance(part, PositionPart) and part.encoder_bias and not reads_bias:
            detail = "No `joint_positions` of the observation has a `bias` that the servos could follow."
            yield Problem(f"{pointer}/encoder_bias", detail)


def _with_pointers(action: JointAction, here: str) -> Sequence[tuple[str, JointPart]]:
    is_mixed = isinstance(action, MixedAction)
    return [(f"{here}/terms/{place}" if is_mixed else here, part) for place, part in enumerate(action.parts)]


def _of_part(part: JointPart, pointer: str, model: Inventory) -> Iterator[Problem]:
    """Joints that a part does not find or cannot drive, and scales of joints that are not there."""
    joints = [joint.name for joint in model.moving_joints()]
    yield from unmatched(part.joints or (), joints, _JOINT, f"{pointer}/joints")
    if isinstance(scales := getattr(part, "scale", None), dict):
        for pattern in scales:
            yield from unmatched_by(pattern, joints, _JOINT, f"{pointer}/scale")
    named = zip(model.acting, model.actuators, strict=True)
    driven = [(name, actuator) for name, actuator in named if part.drives(actuator.joint or "")]
    if not driven:
        yield Problem(f"{pointer}/joints", "No actuator moves any of these joints.")
    for name, actuator in driven:
        if actuator.kind not in (None, part.actuator):
            yield Problem(
                f"{pointer}/kind",
                f"The actuator {name!r} is no {part.what}, as {getattr(part, 'kind', '')} needs: give its "
                "joint one in `edits.servos`, or take another action.",
            )
            return


def _of_overlap(parts: Sequence[tuple[str, JointPart]], model: Inventory) -> Iterator[Problem]:
    """The first joint that two parts drive."""
    for actuator in model.actuators:
        driving = [place for place, (_, part) in enumerate(parts) if part.drives(actuator.joint or "")]
        if len(driving) > 1:
            detail = f"The joint {actuator.joint!r} is driven by term {driving[0]} of the action already."
            yield Problem(f"{parts[driving[1]][0]}/joints", detail)
            return


def _of_the_others(action: JointAction, model: Inventory, here: str) -> Iterator[Problem]:
    """The first actuator that no part drives, and that cannot keep the pose."""
    for actuator in model.actuators:
        is_driven = any(part.drives(actuator.joint or "") for part in action.parts)
        if not is_driven and actuator.kind not in (None, "position"):
            yield Problem(
                f"{here}/{'terms' if isinstance(action, MixedAction) else 'joints'}",
                f"The actuator {actuator.name!r} is not acted on, and is no position servo that could keep "
                "the pose.",
            )
            return
