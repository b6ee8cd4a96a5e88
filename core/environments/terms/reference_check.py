"""Whether a task's reference fits its model and the rest of the task."""

from collections.abc import Iterator

from core.environments.terms.inventory import Inventory
from core.environments.terms.reference import Reference, compared_bodies
from core.environments.terms.task import TaskOptions
from core.environments.terms.unmatched import instead_of, unmatched
from core.errors import Problem

_OPTIONS = "/environment/options"
_FREE = "A reference moves the root freely, and the body {root!r} has no free joint: name another `root`."
_UNREAD = (
    "No term of the reward reads the reference, so nothing would follow it: add `track_joints`, "
    "`track_root_position`, or others that begin with `track_` and need a reference."
)


def problems(options: TaskOptions, model: Inventory) -> Iterator[Problem]:
    """What is wrong with the reference, if there is one."""
    here = f"{_OPTIONS}/reference"
    if (reference := options.reference) is None:
        return
    root = options.root or model.root
    if not any(joint.type == "free" and joint.body == root for joint in model.joints):
        yield Problem(here, _FREE.format(root=root))
    yield from _of_bodies(reference, model, here)
    if not any("reference" in term.needed for term in options.reward or ()):
        yield Problem(here, _UNREAD)
    if options.terrain is not None:
        detail = "Clips are followed on the model's own ground: leave `terrain` or `reference` out."
        yield Problem(f"{_OPTIONS}/terrain", detail)
    for part in ("fallen", "joints"):
        if getattr(options.reset, part) is not None:
            detail = f"An episode begins where the clip is: leave `reset.{part}` out, or the reference."
            yield Problem(f"{_OPTIONS}/reset/{part}", detail)


def _of_bodies(reference: Reference, model: Inventory, here: str) -> Iterator[Problem]:
    """Names and patterns that the model lacks."""
    bodies = model.bodies[1:]
    yield from unmatched(reference.bodies or (), bodies, "body", f"{here}/bodies")
    yield from unmatched(reference.end_effectors or (), bodies, "body", f"{here}/end_effectors")
    if reference.anchor is not None and reference.anchor not in bodies:
        hint = instead_of(reference.anchor, bodies)
        yield Problem(f"{here}/anchor", f"The model has no body {reference.anchor!r}; {hint}")
    if reference.bodies is None and not compared_bodies(reference, model):
        yield Problem(f"{here}/bodies", "No joint moves a body, so there is nothing to compare.")
