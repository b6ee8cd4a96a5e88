"""Whether the terms of a job fit the model that it names."""

from collections.abc import Collection, Iterable, Iterator, Sequence
from functools import cached_property
from inspect import get_annotations
from itertools import islice

from core.bounds import MOST_OBSERVED, MOST_PROBLEMS
from core.documents import Strict
from core.environments.info import Slice
from core.environments.mjcf import action_check
from core.environments.randomization import FIELDS
from core.environments.terms import reference_check
from core.environments.terms.actions import JointPart
from core.environments.terms.commands import AnyCommand, PositionCommand, VelocityCommand
from core.environments.terms.imitation import TrackJoints, TrackJointVelocities
from core.environments.terms.inventory import Inventory, Kind, ModelParts, names_by_kind
from core.environments.terms.locomotion import JointPositions, JointVelocities, Posture, VariablePosture
from core.environments.terms.observations import Activation, ObservationTerm, Qpos, Sensors
from core.environments.terms.randomized import Randomized
from core.environments.terms.rewards import Contact, Distance, ForwardVelocity, JointLimits, VelocityTracking
from core.environments.terms.task import (
    MOST_FEET,
    Reset,
    TaskOptions,
    control_step_s,
    observed,
    parts_of,
)
from core.environments.terms.term import Need, OfBodyContact, Term, whole_steps
from core.environments.terms.terminations import OutsideJointRange, Touching
from core.environments.terms.unmatched import instead_of, no_keyframe, unmatched, unmatched_by
from core.errors import Problem

_OPTIONS = "/environment/options"
_JOINT = "hinge or slide"
_TOUCHING = "body with a geom that can touch anything"
# A model may have thousands of parts, so only the first wrong names are compared with them.
_MAX_HINTS = 3
# Their `joints` are patterns.
_BY_PATTERN = (
    JointPositions | JointVelocities | OutsideJointRange | JointPart | TrackJoints | TrackJointVelocities
)
# The fields of terms that name parts of the model, and the kind of part.
_NAMING: dict[str, Kind] = {
    "body": "body",
    "target": "body",
    "bodies": "body",
    "geoms": "geom",
    "against": "geom",
    "joints": "joint",
    "names": "sensor",
}


class _Parts:
    """The names of a model's parts, and how many wrong ones were told what is like them."""

    def __init__(self, model: Inventory) -> None:
        self.model = model
        self.num_hints = 0
        self._known: dict[Kind, dict[str, None]] = {}

    def known(self, kind: Kind) -> dict[str, None]:
        """In the model's order."""
        if kind not in self._known:
            self._known[kind] = dict.fromkeys(self.model.names(kind))
        return self._known[kind]

    @cached_property
    def touching(self) -> list[str]:
        """The bodies that have a geom which can touch something; all, where these are not known."""
        colliders = self.model.colliders
        if colliders is None:
            return self.model.bodies[1:]
        return list(dict.fromkeys(on[0] for on in colliders.values()))

    @cached_property
    def has_range(self) -> bool:
        """Whether any joint has one."""
        return any(joint.range is not None for joint in self.model.joints)

    @cached_property
    def moving(self) -> frozenset[str]:
        """The bodies that have a joint."""
        return frozenset(joint.body for joint in self.model.joints)

    @cached_property
    def free(self) -> frozenset[str]:
        """The bodies that have a free joint."""
        return frozenset(joint.body for joint in self.model.joints if joint.type == "free")


def problems(options: TaskOptions, model: Inventory) -> list[Problem]:
    """Places where the options name something that the model does not have, up to fifty."""
    found = list(islice(_of_options(options, _Parts(model)), MOST_PROBLEMS))
    if found:
        return found
    seen_by = parts_of(options, model)
    for field, terms in (("observation", observed(options)), ("critic", options.critic or ())):
        steps = (whole_steps(term.delay, control_step_s(options, model)).stop for term in terms)
        number = sum(
            (term.history + most - 1) * term.size(seen_by) for term, most in zip(terms, steps, strict=True)
        )
        if number > MOST_OBSERVED:
            detail = f"The {field} has {number:,} numbers; at most {MOST_OBSERVED:,} are allowed."
            return [Problem(f"{_OPTIONS}/{field}", detail)]
    return list(islice(_of_critic(options, seen_by), MOST_PROBLEMS))


def _of_options(options: TaskOptions, parts: _Parts) -> Iterator[Problem]:
    model = parts.model
    yield from _of_name(options.root, f"{_OPTIONS}/root", "body", parts)
    for here, term in _terms(options):
        if isinstance(term, Randomized):
            yield from _of_randomized(term, here, parts)
            continue
        yield from _of_term(term, here, parts)
        if isinstance(term, Qpos) and term.root_position is not None:
            yield from _of_root(options.root or model.root, here, parts)
        if isinstance(term, ForwardVelocity | VelocityTracking | Distance):
            yield from _of_movement(term, options.root or model.root, here, parts)
    yield from _of_needs(options, parts)
    yield from _of_patterns(options, parts)
    yield from action_check.problems(options, model, f"{_OPTIONS}/action")
    yield from reference_check.problems(options, model)
    yield from _of_delays(options, model)
    yield from _of_reset(options.reset, model)
    if options.terrain is not None:
        yield from _of_terrain(options.root or model.root, parts)


def _of_terrain(root: str, parts: _Parts) -> Iterator[Problem]:
    """A robot that cannot begin at another height, and ground that would be in a terrain's way."""
    if root not in parts.free:
        yield Problem(f"{_OPTIONS}/terrain", f"A terrain needs {_NEEDED['free_root'].format(root=root)}.")
    if parts.model.has_level_floor is False:
        yield Problem(
            f"{_OPTIONS}/terrain",
            "A terrain's boxes stand on a level plane that is all of the world that can be touched, and the "
            "model has none: add one (`edits.floor`), or let nothing else of the world collide.",
        )


def _of_delays(options: TaskOptions, model: Inventory) -> Iterator[Problem]:
    """Delays that would always be 0, or that no whole number of control steps makes."""
    control_step = control_step_s(options, model)
    late = [(pointer, term.delay) for pointer, term in _terms(options) if isinstance(term, ObservationTerm)]
    for pointer, delay in (*late, (f"{_OPTIONS}/action", options.action.delay)):
        steps = whole_steps(delay, control_step)
        if delay is not None and steps.stop <= max(steps.start, 1):
            low = control_step * max(1, round(delay[0] / control_step))
            yield Problem(
                f"{pointer}/delay",
                f"No whole number of control steps of {control_step:g} s lies between {delay[0]:g} and "
                f"{delay[1]:g} s, except none: take for example [{low:g}, {low:g}].",
            )


def _of_needs(options: TaskOptions, parts: _Parts) -> Iterator[Problem]:
    """Terms without what they need, and a command and a clock that fit nothing."""
    root = options.root or parts.model.root
    bare = _feet_without_colliders(options, parts.model)
    words = {"root": root, "foot": next(iter(bare), None)}
    has: dict[Need, bool] = {
        "command": options.command is not None,
        "command_height": _has_part(options.command, "height"),
        "command_pitch": _has_part(options.command, "pitch"),
        "position_command": isinstance(options.command, PositionCommand),
        "velocity_command": isinstance(options.command, VelocityCommand),
        "feet": bool(options.feet),
        "foot_colliders": not bare,
        "free_root": root in parts.free,
        "gait": options.gait is not None,
        "reference": options.reference is not None,
        "terrain": options.terrain is not None,
    }
    for pointer, term in _terms(options):
        for need in sorted(term.needed - {need for need, is_there in has.items() if is_there}):
            yield Problem(pointer, f"The {term.noun} {term.label} needs {_NEEDED[need].format(**words)}.")
    yield from _of_unread_command(options)
    if options.reset.moves_root and not has["free_root"]:
        for part in ("pose", "velocity", "fallen"):
            if getattr(options.reset, part) is not None:
                detail = f"A random {part} of the root needs {_NEEDED['free_root'].format(**words)}."
                yield Problem(f"{_OPTIONS}/reset/{part}", detail)
    if options.reset.joints is not None and not parts.has_range:
        yield Problem(f"{_OPTIONS}/reset/joints", "None of the model's joints has a range.")
    yield from _of_feet(options, parts.model)


def _has_part(command: AnyCommand | None, part: str) -> bool:
    return isinstance(command, VelocityCommand) and getattr(command, part) is not None


def _of_unread_command(options: TaskOptions) -> Iterator[Problem]:
    """A command, or a part of it, that no term of the reward reads."""
    read = frozenset[Need]().union(*(term.needs for term in options.reward or ()))
    here, command = f"{_OPTIONS}/command", options.command
    if isinstance(command, PositionCommand) and "position_command" not in read:
        yield Problem(here, "No term of the reward reads the command's point: add `track_position`.")
    if isinstance(command, VelocityCommand):
        if not read & {"command", "velocity_command"}:
            yield Problem(here, "No term of the reward reads the command, so nothing would follow it.")
        parts: tuple[tuple[str, Need], ...] = (("height", "command_height"), ("pitch", "command_pitch"))
        for part, need in parts:
            if _has_part(command, part) and need not in read:
                yield Problem(
                    f"{here}/{part}", f"No term of the reward reads the command's {part}: add `track_{part}`."
                )


def _feet_without_colliders(options: TaskOptions, model: Inventory) -> list[str]:
    """Feet without a geom that can touch anything; none of a model that was described before they were
    noted."""
    if model.colliders is None:
        return []
    return [foot for foot, geoms in parts_of(options, model).feet_colliders.items() if not geoms]


def _of_feet(options: TaskOptions, model: Inventory) -> Iterator[Problem]:
    here, bodies = f"{_OPTIONS}/feet", model.bodies[1:]
    missing = list(unmatched(options.feet, bodies, "body", here))
    yield from missing
    number = len(parts_of(options, model).feet)
    if number > MOST_FEET:
        yield Problem(here, f"The patterns match {number} bodies; a task has at most {MOST_FEET} feet.")
    elif options.gait and not missing and len(options.gait.offsets) != number:
        detail = f"The clock has {len(options.gait.offsets)} offsets, and the task {number} feet."
        yield Problem(f"{_OPTIONS}/gait/offsets", detail)


_NEEDED: dict[Need, str] = {
    "command": "a `command`",
    "command_height": "a `command` of the kind `velocity` with a `height`",
    "command_pitch": "a `command` of the kind `velocity` with a `pitch`",
    "position_command": "a `command` of the kind `position`",
    "velocity_command": "a `command` of the kind `velocity`",
    "feet": "`feet`",
    "foot_colliders": "feet that can touch something, and no geom of {foot!r} can",
    "free_root": "a free joint of the root, and the body {root!r} has none",
    "gait": "a `gait`",
    "reference": "a `reference`: the clips that the body follows",
    "terrain": "a `terrain`",
}


def _terms(options: TaskOptions) -> Iterator[tuple[str, Term]]:
    """All terms, with their pointers."""
    for field in ("reward", "observation", "critic", "termination", "metrics"):
        terms: Sequence[Term] = getattr(options, field) or ()
        for number, term in enumerate(terms):
            here = f"{_OPTIONS}/{field}/{number}"
            yield here, term
            yield from ((f"{here}/unless/{place}", inner) for place, inner in enumerate(term.inner))
    if options.command is not None:
        yield f"{_OPTIONS}/command", options.command
    yield f"{_OPTIONS}/action", options.action
    yield from ((f"{_OPTIONS}/events/{number}", event) for number, event in enumerate(options.events))


def _of_patterns(options: TaskOptions, parts: _Parts) -> Iterator[Problem]:
    """Patterns of joints that match none."""
    joints = [joint.name for joint in parts.model.moving_joints()]
    tables: list[tuple[str, Iterable[str]]] = []
    for here, term in _terms(options):
        if isinstance(term, Posture):
            tables.append((f"{here}/weights", term.weights))
        if isinstance(term, VariablePosture):
            tables += [
                (f"{here}/{field}", getattr(term, field)) for field in ("standing", "walking", "running")
            ]
        if isinstance(term, OfBodyContact):
            yield from unmatched(term.bodies, parts.touching, _TOUCHING, f"{here}/bodies")
        if isinstance(term, _BY_PATTERN) and not isinstance(term, JointPart):
            yield from unmatched(term.joints or (), joints, _JOINT, f"{here}/joints")
        if isinstance(term, Qpos):
            yield from unmatched(term.without or (), joints, _JOINT, f"{here}/without")
    for pointer, patterns in tables:
        for pattern in patterns:
            yield from unmatched_by(pattern, joints, _JOINT, pointer)


def _of_critic(options: TaskOptions, model: ModelParts) -> Iterator[Problem]:
    """The numbers that the policy sees and the critic does not: such a critic could not judge the policy."""
    if options.critic is None:
        return
    seen = {part for term in options.critic for part in _numbers(term.slices(model))}
    for term in observed(options):
        missing = [part for part in _numbers(term.slices(model)) if part not in seen]
        if missing:
            name, component = missing[0]
            what = f"{component!r} of {name}" if isinstance(component, str) else name
            yield Problem(
                f"{_OPTIONS}/critic",
                f"The critic sees less than the policy, which sees {what}: repeat the policy's terms in it.",
            )


def _numbers(slices: Iterable[Slice]) -> Iterator[tuple[str, str | int]]:
    """The name of each number's slice, and its own; how many there are where they have no names."""
    for part in slices:
        yield from ((part.name, component) for component in part.components or (part.size,))


def _of_randomized(term: Randomized, pointer: str, parts: _Parts) -> Iterator[Problem]:
    about, model = FIELDS[term.field], parts.model
    if term.axis is not None and term.axis >= about.size:
        detail = f"{term.field} has {about.size} numbers for each, counted from 0."
        yield Problem(f"{pointer}/axis", detail)
    if about.kind is None and term.names:
        yield Problem(f"{pointer}/names", f"{term.field} belongs to the whole model, and has no names.")
    if about.kind is None:
        return
    known = names_by_kind(model)[about.kind]
    for number, name in enumerate(term.names or ()):
        if name not in known:
            yield from _unknown(name, f"{pointer}/names/{number}", about.kind, known, parts)


def _of_term(term: Strict, pointer: str, parts: _Parts) -> Iterator[Problem]:
    for field, kind in _NAMING.items():
        if field == "joints" and isinstance(term, _BY_PATTERN):
            continue
        if (field == "bodies" and isinstance(term, OfBodyContact)) or not _has_of_ours(term, field):
            continue
        named: str | list[str] | None = getattr(term, field)
        if isinstance(named, list):
            for number, name in enumerate(named):
                yield from _of_name(name, f"{pointer}/{field}/{number}", kind, parts)
        else:
            yield from _of_name(named, f"{pointer}/{field}", kind, parts)
    if isinstance(term, Sensors) and not parts.model.sensors:
        yield Problem(pointer, "The model has no sensors.")
    if isinstance(term, JointLimits) and not parts.has_range:
        yield Problem(pointer, "None of the model's joints has a range.")
    if isinstance(term, Contact | Touching) and term.against in term.geoms:
        yield Problem(f"{pointer}/against", f"The geom {term.against!r} never touches itself.")
    if isinstance(term, Activation) and not parts.model.sizes.na:
        yield Problem(pointer, "None of the model's actuators has a state (na = 0).")


def _has_of_ours(term: Strict, field: str) -> bool:
    """Whether the term has the field, and from a class of ours: one of a package means what that says."""
    parts = (part for part in type(term).__mro__ if part.__module__.partition(".")[0] != "core")
    return field in type(term).model_fields and not any(field in get_annotations(part) for part in parts)


def _of_root(root: str, pointer: str, parts: _Parts) -> Iterator[Problem]:
    if root not in parts.free:
        yield Problem(
            f"{pointer}/root_position",
            f"The body {root!r} has no free joint, so qpos does not hold its position: leave "
            "root_position out.",
        )


def _of_movement(
    term: ForwardVelocity | VelocityTracking | Distance, root: str, pointer: str, parts: _Parts
) -> Iterator[Problem]:
    """Terms that would be the same in every step, which teaches nothing."""
    body = term.body or root
    if isinstance(term, Distance):
        if term.target == body:
            yield Problem(f"{pointer}/target", f"The distance of the body {body!r} to itself is always 0.")
        return
    model = parts.model
    bolted = not model.travels and body == model.root and body not in parts.moving
    centre = isinstance(term, ForwardVelocity) and term.of == "centre_of_mass"
    if body == "world" or (bolted and not centre):
        yield Problem(
            f"{pointer}/body",
            f"The body {body!r} has no joint, so it never moves: name another body, or give the root a free "
            "joint.",
        )


def _of_name(name: str | None, pointer: str, kind: Kind, parts: _Parts) -> Iterator[Problem]:
    if name is None or name in (known := parts.known(kind)):
        return
    yield from _unknown(name, pointer, "joint with a range" if kind == "joint" else kind, known, parts)


def _unknown(name: str, pointer: str, what: str, known: Collection[str], parts: _Parts) -> Iterator[Problem]:
    parts.num_hints += 1
    hint = instead_of(name, known, is_compared=parts.num_hints <= _MAX_HINTS)
    yield Problem(pointer, f"The model has no {what} {name!r}; {hint}")


def _of_reset(reset: Reset, model: Inventory) -> Iterator[Problem]:
    if reset.qpos is not None and len(reset.qpos) != model.sizes.nq:
        yield Problem(
            f"{_OPTIONS}/reset/qpos",
            f"The model has {model.sizes.nq} positions (nq); {len(reset.qpos)} were given.",
        )
    elif reset.qpos is not None:
        for joint in model.joints:
            start = {"free": joint.qpos_start + 3, "ball": joint.qpos_start}.get(joint.type)
            if start is not None and not any(reset.qpos[start : start + 4]):
                name = joint.name or f"{joint.body} {joint.type}"
                detail = f"The orientation of the joint {name!r} is not a quaternion: [0, 0, 0, 0]."
                yield Problem(f"{_OPTIONS}/reset/qpos/{start}", detail)
    known = model.keyframes
    there = reset.keyframe in known if isinstance(reset.keyframe, str) else (reset.keyframe or 0) < len(known)
    if reset.keyframe is not None and not there:
        yield no_keyframe(reset.keyframe, model, f"{_OPTIONS}/reset/keyframe")
