"""The differences between two environments that keep a job from resuming from a checkpoint of the other."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import Any, cast

from core.errors import Rejected
from core.jobs.resolved import resolve_environment
from core.jobs.spec import EnvironmentSpec

# Numbers below these parts of the options change what an environment pays, how an episode begins and when it
# ends. A checkpoint's arrays have the same shapes under any of them.
_PAYING = ("reward", "weight", "cost")
_OF_EPISODES = ("reset", "termination")
_MOST_SHOWN = 100

_Place = tuple[str | int, ...]


def difference(had: EnvironmentSpec, has: EnvironmentSpec, free: Sequence[str]) -> tuple[str, str] | None:
    """The first difference that matters: its JSON pointer and the sentence's end; None if there is none.

    had: of the checkpoint's job. free: options that may differ.
    """
    if had.id != has.id:
        return "/environment/id", f"{had.id!r} there and {has.id!r} here"
    there, here = (
        {name: value for name, value in _options(one).items() if name not in free} for one in (had, has)
    )
    for place, one, other in _differing(there, here, ()):
        if not (_is_number(one) and _is_number(other) and _is_harmless(place)):
            pointer = "".join(f"/{str(part)[:_MOST_SHOWN]}" for part in place)
            return f"/environment/options{pointer}", f"{_shown(one)} there and {_shown(other)} here"
    return None


def _options(environment: EnvironmentSpec) -> dict[str, Any]:
    """The options with their defaults."""
    # An option that this version refuses may be of a job of another version.
    with suppress(Rejected):
        return resolve_environment(environment)[1].model_dump(mode="json")
    return environment.options


def _differing(one: Any, other: Any, place: _Place) -> Iterator[tuple[_Place, Any, Any]]:
    if isinstance(one, dict) and isinstance(other, dict):
        one, other = cast("dict[str, Any]", one), cast("dict[str, Any]", other)
        # The kind comes first: where it differs, options that only one kind has explain less.
        for name in sorted({**one, **other}, key=lambda name: name != "kind"):
            yield from _differing(one.get(name), other.get(name), (*place, name))
    elif isinstance(one, list) and isinstance(other, list):
        these, those = cast("list[Any]", one), cast("list[Any]", other)
        if len(these) != len(those):
            yield place, these, those
            return
        for number, pair in enumerate(zip(these, those, strict=True)):
            yield from _differing(*pair, (*place, number))
    elif one != other:
        yield place, one, other


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_harmless(place: _Place) -> bool:
    pays = any(word in part for part in place if isinstance(part, str) for word in _PAYING)
    return pays or place[0] in _OF_EPISODES


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= _MOST_SHOWN else f"{text[:_MOST_SHOWN]}…"
