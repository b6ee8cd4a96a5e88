"""Whether the terms of a job fit the model that it names."""

import difflib
from collections.abc import Iterator, Sequence

from core.documents import Strict
from core.environments.mjcf.info import MjcfOptions
from core.environments.mjcf.inventory import Inventory, Kind
from core.environments.mjcf.vocabulary.observations import Activation, Qpos, Sensors
from core.environments.mjcf.vocabulary.reset import Reset
from core.environments.mjcf.vocabulary.rewards import (
    Contact,
    Distance,
    ForwardVelocity,
    JointLimits,
    VelocityTracking,
)
from core.environments.mjcf.vocabulary.terminations import Touching
from core.errors import Problem

_OPTIONS = "/environment/options"
_MAX_NAMES = 20
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


def problems(options: MjcfOptions, model: Inventory) -> list[Problem]:
    """Each place where the options name something that the model does not have."""
    found = list(_of_name(options.root, f"{_OPTIONS}/root", "body", model))
    for field in ("reward", "observation", "termination"):
        terms: Sequence[Strict] = getattr(options, field) or ()
        for number, term in enumerate(terms):
            found += _of_term(term, f"{_OPTIONS}/{field}/{number}", model)
            if isinstance(term, Qpos) and term.root_position is not None:
                found += _of_root(options.root or model.root, f"{_OPTIONS}/{field}/{number}", model)
            if isinstance(term, ForwardVelocity | VelocityTracking | Distance):
                found += _of_movement(term, options.root or model.root, f"{_OPTIONS}/{field}/{number}", model)
    return [*found, *_of_reset(options.reset, model)]


def _of_term(term: Strict, pointer: str, model: Inventory) -> Iterator[Problem]:
    for field, kind in _NAMING.items():
        named: str | list[str] | None = getattr(term, field, None)
        if isinstance(named, list):
            for number, name in enumerate(named):
                yield from _of_name(name, f"{pointer}/{field}/{number}", kind, model)
        else:
            yield from _of_name(named, f"{pointer}/{field}", kind, model)
    if isinstance(term, Sensors) and not model.sensors:
        yield Problem(pointer, "The model has no sensors.")
    if isinstance(term, JointLimits) and all(joint.range is None for joint in model.joints):
        yield Problem(pointer, "None of the model's joints has a range.")
    if isinstance(term, Contact | Touching) and term.against in term.geoms:
        yield Problem(f"{pointer}/against", f"The geom {term.against!r} never touches itself.")
    if isinstance(term, Activation) and not model.sizes.na:
        yield Problem(pointer, "None of the model's actuators has a state (na = 0).")


def _of_root(root: str, pointer: str, model: Inventory) -> Iterator[Problem]:
    if not any(joint.type == "free" and joint.body == root for joint in model.joints):
        yield Problem(
            f"{pointer}/root_position",
            f"The body {root!r} has no free joint, so qpos does not hold its position: leave "
            "root_position out.",
        )


def _of_movement(
    term: ForwardVelocity | VelocityTracking | Distance, root: str, pointer: str, model: Inventory
) -> Iterator[Problem]:
    """Terms that would be the same in every step, which teaches nothing."""
    body = term.body or root
    if isinstance(term, Distance):
        if term.target == body:
            yield Problem(f"{pointer}/target", f"The distance of the body {body!r} to itself is always 0.")
        return
    bolted = not model.travels and body == model.root and all(joint.body != body for joint in model.joints)
    centre = isinstance(term, ForwardVelocity) and term.of == "centre_of_mass"
    if body == "world" or (bolted and not centre):
        yield Problem(
            f"{pointer}/body",
            f"The body {body!r} has no joint, so it never moves: name another body, or give the root a free "
            "joint.",
        )


def _of_name(name: str | None, pointer: str, kind: Kind, model: Inventory) -> Iterator[Problem]:
    known = model.names(kind)
    if name is None or name in known:
        return
    what = "joint with a range" if kind == "joint" else kind
    near = difflib.get_close_matches(name, known, n=3, cutoff=0.5)
    if near:
        hint = f"did you mean {' or '.join(map(repr, near))}?"
    elif known:
        hint = f"it has {', '.join(known[:_MAX_NAMES])}{', …' if len(known) > _MAX_NAMES else ''}."
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
                detail = f"The orientation of the joint {joint.name!r} is not a quaternion: [0, 0, 0, 0]."
                yield Problem(f"{_OPTIONS}/reset/qpos/{start}", detail)
    known = model.keyframes
    there = reset.keyframe in known if isinstance(reset.keyframe, str) else (reset.keyframe or 0) < len(known)
    if reset.keyframe is not None and not there:
        named = ", ".join(filter(None, known))
        has = f"it has {len(known)}{f', among them {named}' if named else ''}" if known else "it has none"
        yield Problem(f"{_OPTIONS}/reset/keyframe", f"The model has no keyframe {reset.keyframe!r}; {has}.")
