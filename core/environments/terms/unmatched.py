"""Names and patterns of parts that a model lacks, said with what is like them; no numerical code."""

from collections.abc import Collection, Iterable, Iterator, Sequence
from itertools import islice

from core.bounds import LONGEST_NAME
from core.environments.terms.inventory import Inventory
from core.errors import Problem
from core.nearest import nearest
from core.patterns import matches

_MAX_NAMES = 20


def unmatched(patterns: Iterable[str], names: Sequence[str], kind: str, pointer: str) -> Iterator[Problem]:
    """A problem for each pattern of a list that matches none of the names. pointer: of the list."""
    for number, pattern in enumerate(patterns):
        yield from unmatched_by(pattern, names, kind, f"{pointer}/{number}")


def unmatched_by(pattern: str, names: Sequence[str], kind: str, pointer: str) -> Iterator[Problem]:
    """A problem if the pattern matches none of the names. kind: of these parts, such as "moving geom"."""
    if any(matches(pattern, name) for name in names):
        return
    hint = instead_of(pattern.replace(".*", ""), names)
    yield Problem(pointer, f"The model has no {kind} that {pattern!r} matches; {hint}")


def instead_of(name: str, names: Collection[str], *, is_compared: bool = True) -> str:
    """The end of a sentence about a name that a model lacks: the names that it has instead. is_compared:
    whether to look for similar names, which takes long among many."""
    near = nearest(name, filter(None, names), number=3, cutoff=0.5) if is_compared else ()
    if near:
        return f"did you mean {' or '.join(map(repr, near))}?"
    if not names:
        return "it has none with a name."
    some = ", ".join(one[:LONGEST_NAME] for one in islice(filter(None, names), _MAX_NAMES))
    return f"it has {some}{', …' if len(names) > _MAX_NAMES else ''}."


def no_keyframe(name: str | int, model: Inventory, pointer: str) -> Problem:
    """The problem that the model has no such keyframe."""
    some = ", ".join(one[:LONGEST_NAME] for one in islice(filter(None, model.keyframes), _MAX_NAMES))
    has = f"{len(model.keyframes)}{f', among them {some}' if some else ''}" if model.keyframes else "none"
    return Problem(pointer, f"The model has no keyframe {name!r}; it has {has}.")
