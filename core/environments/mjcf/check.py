"""Whether the terms of a job fit the model that it names."""

from collections.abc import Iterator, Sequence
from functools import cached_property
from itertools import islice

from core.bounds import LONGEST_NAME, MOST_OBSERVED, MOST_PROBLEMS
from core.documents import Strict
from core.environments.mjcf.info import MjcfOptions, Reset, observed
from core.environments.terms.inventory import Inventory, Kind
from core.environments.terms.observations import Activation, Qpos, Sensors
from core.environments.terms.rewards import Contact, Distance, ForwardVelocity, JointLimits, VelocityTracking
from core.environments.terms.terminations import Touching
from core.errors import Problem
from core.nearest import nearest

_OPTIONS = "/environment/options"
_MAX_NAMES = 20
# A model may have thousands of parts, so only the first wrong names are compared with them.
_MAX_HINTS = 3
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


def problems(options: MjcfOptions, model: Inventory) -> list[Problem]:
    """Places where the options name something that the model does not have, up to fifty."""
    found = list(islice(_of_options(options, _Parts(model)), MOST_PROBLEMS))
    if not found and (number := sum(term.size(model) for term in observed(options))) > MOST_OBSERVED:
        detail = f"The observation has {number:,} numbers; at most {MOST_OBSERVED:,} are allowed."
        return [Problem(f"{_OPTIONS}/observation", detail)]
    return found


def _of_options(options: MjcfOptions, parts: _Parts) -> Iterator[Problem]:
    model = parts.model
    yield from _of_name(options.root, f"{_OPTIONS}/root", "body", parts)
    for field in ("reward", "observation", "termination"):
        terms: Sequence[Strict] = getattr(options, field) or ()
        for number, term in enumerate(terms):
            here = f"{_OPTIONS}/{field}/{number}"
            yield from _of_term(term, here, parts)
            if isinstance(term, Qpos) and term.root_position is not None:
                yield from _of_root(options.root or model.root, here, parts)
            if isinstance(term, ForwardVelocity | VelocityTracking | Distance):
                yield from _of_movement(term, options.root or model.root, here, parts)
    yield from _of_reset(options.reset, model)


def _of_term(term: Strict, pointer: str, parts: _Parts) -> Iterator[Problem]:
    for field, kind in _NAMING.items():
        named: str | list[str] | None = getattr(term, field, None)
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
    what = "joint with a range" if kind == "joint" else kind
    parts.num_hints += 1
    near = nearest(name, known, number=3, cutoff=0.5) if parts.num_hints <= _MAX_HINTS else ()
    if near:
        hint = f"did you mean {' or '.join(map(repr, near))}?"
    elif known:
        some = ", ".join(f"{one:.{LONGEST_NAME}}" for one in islice(known, _MAX_NAMES))
        hint = f"it has {some}{', …' if len(known) > _MAX_NAMES else ''}."
    else:
        hint = "it has none with a name."
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
        named = ", ".join(one[:LONGEST_NAME] for one in islice(filter(None, known), _MAX_NAMES))
        has = f"it has {len(known)}{f', among them {named}' if named else ''}" if known else "it has none"
        yield Problem(f"{_OPTIONS}/reset/keyframe", f"The model has no keyframe {reset.keyframe!r}; {has}.")
