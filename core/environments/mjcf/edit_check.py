"""Whether the changes of a model fit it, and what they make of its parts; no numerical code."""

from collections.abc import Iterator, Sequence

from core.environments.mjcf.edit_options import HOME, ModelEdits, Pose, Servo, free_name
from core.environments.terms.inventory import Actuator, Inventory, Joint
from core.environments.terms.unmatched import no_keyframe, unmatched, unmatched_by
from core.errors import Problem
from core.patterns import matching

_DRIVEN = ("hinge", "slide")
# rad or m: poses are written with fewer digits than ranges.
_SLACK = 1e-2


def problems(edits: ModelEdits, model: Inventory, pointer: str) -> Iterator[Problem]:
    """Places where the changes name something that the model, before them, does not have. pointer: theirs."""
    driven = [joint.name for joint in model.joints if joint.type in _DRIVEN]
    if edits.servos and model.actuators and model.colliders is None:
        detail = (
            "The model was added to an earlier version, which did not note what actuators move: delete it, "
            "and add it again."
        )
        yield Problem(f"{pointer}/servos", detail)
        return
    for number, fit in enumerate(edits.primitives):
        yield from unmatched(fit.geoms, model.geoms, "geom", f"{pointer}/primitives/{number}/geoms")
    yield from _of_feet(edits, model, pointer)
    if isinstance(edits.collide, list):
        yield from unmatched(edits.collide, _moving(model), "moving geom", f"{pointer}/collide")
    for number, servo in enumerate(edits.servos):
        yield from unmatched(servo.joints, driven, "hinge or slide", f"{pointer}/servos/{number}/joints")
        yield from _without_stiffness(servo, model, f"{pointer}/servos/{number}/kp")
    yield from _named_twice(edits.servos, driven, pointer)
    if not _actuators(model, edits.servos):
        detail = "The model has no actuators, so no policy could move it: name joints that servos move."
        yield Problem(f"{pointer}/servos", detail)
    if edits.pose is not None:
        yield from _of_pose(edits.pose, model, driven, f"{pointer}/pose")


def _of_feet(edits: ModelEdits, model: Inventory, pointer: str) -> Iterator[Problem]:
    if edits.collide == "feet" and edits.feet is None:
        yield Problem(f"{pointer}/feet", "Only the feet are to collide, but no foot is named.")
    bodies = model.bodies[1:]
    yield from unmatched(edits.feet or [], bodies, "body", f"{pointer}/feet")
    if edits.collide != "feet" or model.colliders is None:
        return
    carriers = {body for bodies in model.colliders.values() for body in bodies}
    for number, pattern in enumerate(edits.feet or []):
        bare = [body for body in matching([pattern], bodies) if body not in carriers]
        if bare:
            detail = f"The foot {bare[0]!r} has no geom that can touch anything, so it would sink."
            yield Problem(f"{pointer}/feet/{number}", detail)


def _without_stiffness(servo: Servo, model: Inventory, pointer: str) -> Iterator[Problem]:
    is_known = servo.effort or servo.saturation_effort or servo.control == "effort"
    if is_known or (servo.kp if servo.control == "position" else servo.kd) is not None:
        return
    weak = {joint.name for joint in model.joints if joint.type in _DRIVEN and joint.effort is None}
    for joint in matching(servo.joints, weak):
        detail = (
            f"The model knows no greatest torque of the joint {joint!r}: give the servo a "
            f"{'kp' if servo.control == 'position' else 'kd'} or an effort."
        )
        yield Problem(pointer, detail)
        break


def _of_pose(pose: Pose, model: Inventory, driven: Sequence[str], pointer: str) -> Iterator[Problem]:
    if pose.keyframe is not None and pose.keyframe not in model.keyframes:
        yield no_keyframe(pose.keyframe, model, f"{pointer}/keyframe")
    before, ranges = dict[str, str](), {joint.name: joint.range for joint in model.joints}
    for pattern, value in pose.joints.items():
        here = f"{pointer}/joints/{pattern.replace('~', '~0').replace('/', '~1')}"
        yield from unmatched_by(pattern, driven, "hinge or slide", here)
        for joint in matching([pattern], driven):
            if joint in before:
                yield Problem(here, f"The joint {joint!r} has a position by {before[joint]!r} already.")
                break
            before[joint] = pattern
            if (within := ranges[joint]) and not within[0] - _SLACK <= value <= within[1] + _SLACK:
                low, high = within
                detail = f"The joint {joint!r} goes from {low:.4g} to {high:.4g}, and not to {value:g}."
                yield Problem(here, detail)
                break


def _named_twice(servos: Sequence[Servo], driven: Sequence[str], pointer: str) -> Iterator[Problem]:
    before = dict[str, int]()
    for number, servo in enumerate(servos):
        twice = [joint for joint in matching(servo.joints, driven) if joint in before]
        if twice:
            yield Problem(
                f"{pointer}/servos/{number}/joints",
                f"The joint {twice[0]!r} has the servo {before[twice[0]]} already.",
            )
        before.update((joint, number) for joint in matching(servo.joints, driven) if joint not in before)


def edited(model: Inventory, edits: ModelEdits) -> Inventory:
    """The parts of the model after changes that fit it; its height and its sensors are told as before."""
    if edits == ModelEdits():  # One that was described before colliders were keeps its number of pairs.
        return model
    actuators = _actuators(model, edits.servos)
    floor = [free_name("floor", model.geoms)] if _needs_floor(model, edits) else []
    keyframes = [name for name in model.keyframes if name != HOME]
    return model.model_copy(
        update={
            "actuators": actuators,
            "sizes": model.sizes.model_copy(
                update={"nu": len(actuators), "ngeom": model.sizes.ngeom + len(floor)}
            ),
            "geoms": [*floor, *model.geoms],
            "has_level_floor": bool(floor) or model.has_level_floor,
            "keyframes": model.keyframes if edits.pose is None else [*keyframes, HOME],
            "colliders": _colliders(model, edits),
            "num_pairs": _num_pairs(model, edits),
        }
    )


def _actuators(model: Inventory, servos: Sequence[Servo]) -> list[Actuator]:
    """Servos come in the place of a joint's first actuator, and after the others where it has none."""
    driven = [joint for joint in model.joints if joint.type in _DRIVEN]
    waiting = dict[str, Actuator]()
    for joint in driven:
        for servo in (one for one in servos if matching(one.joints, [joint.name])):
            waiting.setdefault(joint.name, _servo_of(joint, servo))
    kept, taken = list[Actuator](), {actuator.name for actuator in model.actuators}
    has_servo = set[str]()
    for actuator in model.actuators:
        if actuator.joint in waiting:
            has_servo.add(actuator.joint)
            kept.append(waiting.pop(actuator.joint).model_copy(update={"name": actuator.name}))
        elif actuator.joint not in has_servo:
            kept.append(actuator)
    names = {joint: joint if joint not in taken else f"{joint} servo" for joint in waiting}
    return [*kept, *(waiting[joint].model_copy(update={"name": name}) for joint, name in names.items())]


def _servo_of(joint: Joint, servo: Servo) -> Actuator:
    """The servo of the joint, which is called like it."""
    has_effort = servo.effort or joint.effort or servo.saturation_effort
    return Actuator(
        name=joint.name,
        joint=joint.name,
        kind="motor" if servo.control == "effort" else servo.control,
        velocity_limit=servo.velocity_limit if has_effort else None,
    )


def _moving(model: Inventory) -> list[str]:
    fixed = set(model.fixed_geoms)
    return [name for name in model.geoms if name not in fixed]


def _needs_floor(model: Inventory, edits: ModelEdits) -> bool:
    return edits.floor and not model.num_fixed_colliders


def _colliders(model: Inventory, edits: ModelEdits) -> dict[str, list[str]] | None:
    """As in an inventory; None where the bodies of some are not known."""
    if model.colliders is None or edits.collide in ("declared", "floor"):
        return model.colliders
    if edits.collide == "feet":
        feet = set(matching(edits.feet or [], model.bodies))
        return {geom: on for geom, on in model.colliders.items() if feet.intersection(on)}
    chosen = matching(edits.collide, _moving(model))
    if not model.colliders.keys() >= set(chosen):
        return None
    return {geom: model.colliders[geom] for geom in chosen}


def _num_pairs(model: Inventory, edits: ModelEdits) -> int | None:
    """Pairs of geoms that may touch; None where they are not known."""
    if model.colliders is None or model.num_pairs is None:
        return None
    num_fixed = model.num_fixed_colliders + _needs_floor(model, edits)
    match edits.collide:
        case "declared":
            return model.num_pairs + len(model.colliders) * _needs_floor(model, edits)
        case "floor":
            return len(model.colliders) * num_fixed
        case "feet":
            return num_fixed * len(_colliders(model, edits) or {})
        case patterns:
            return num_fixed * len(matching(patterns, _moving(model)))
