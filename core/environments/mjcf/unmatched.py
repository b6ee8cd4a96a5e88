"""Patterns that match no part of a model, said with what is like them; no numerical code."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import islice

from core.bounds import LONGEST_NAME
from core.environments.patterns import matches
from core.errors import Problem
from core.nearest import nearest

_MAX_NAMES = 20


def unmatched(patterns: Iterable[str], names: Sequence[str], kind: str, pointer: str) -> Iterator[Problem]:
    """A problem for each pattern of a list that matches none of the names. pointer: of the list."""
    for number, pattern in enumerate(patterns):
        yield from unmatched_by(pattern, names, kind, f"{pointer}/{number}")


def unmatched_by(pattern: str, names: Sequence[str], kind: str, pointer: str) -> Iterator[Problem]:
    """A problem if the pattern matches none of the names. kind: of these parts, such as "moving geom"."""
    if any(matches(pattern, name) for name in names):
        return
    near = nearest(pattern.replace(".*", ""), filter(None, names), number=3, cutoff=0.5)
    if near:
        hint = f"did you mean {' or '.join(map(repr, near))}?"
    elif names:
        some = ", ".join(name[:LONGEST_NAME] for name in islice(filter(None, names), _MAX_NAMES))
        hint = f"it has {some}{', …' if len(names) > _MAX_NAMES else ''}."
    else:
        hint = "it has none with a name."
    yield Problem(pointer, f"The model has no {kind} that {pattern!r} matches; {hint}")
