"""Names of a model's parts by regular expressions; no numerical code."""

import re
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from typing import Annotated, TypeVar

from pydantic import AfterValidator, Field
from pydantic_core import SchemaError, SchemaValidator, core_schema

from core.bounds import LONGEST_NAME, MOST_MEMBERS, Real

_Value = TypeVar("_Value")

# ASCII alone: with all of Unicode's letters, a page of `\w` would take gigabytes.
_CLASSES = {"d": "[0-9]", "w": "[0-9A-Za-z_]"}
_COUNTS = "a pattern cannot count repetitions: write `..` for `.{2}`"
_SYNTAX = (
    r"a pattern has letters, `.`, `*`, `+`, `?`, `|`, `[…]`, `(…)`, `\d`, `\w` and escaped punctuation, "
    "but no look-ahead, back-reference or flag"
)


@lru_cache(maxsize=256)
def _matcher(pattern: str) -> SchemaValidator:
    """The matcher of whole names, by pydantic's regular expressions, which are Rust's: their time grows with
    the name alone, whatever the pattern. Raises SchemaError, and ValueError for what we do not take."""
    if "{" in pattern:
        raise ValueError(_COUNTS)
    if re.search(r"\(\?(?!:)", re.sub(r"\\.", "", pattern)):
        raise ValueError(_SYNTAX)
    ours = re.sub(r"\\(.)", _escaped, pattern)
    _compiled(ours)  # By itself: `a)|(b` is none, but would be one in parentheses.
    return _compiled(f"^(?:{ours})$")


def _compiled(pattern: str) -> SchemaValidator:
    return SchemaValidator(core_schema.str_schema(pattern=pattern, regex_engine="rust-regex"))


def _escaped(found: re.Match[str]) -> str:
    if found[1] in _CLASSES:
        return _CLASSES[found[1]]
    if found[1].isalnum():
        raise ValueError(_SYNTAX)
    return found[0]


def _is_regular(pattern: str) -> str:
    try:
        _matcher(pattern)
    except SchemaError as error:
        why = str(error).strip().splitlines()[-1].removeprefix("error: ")
        raise ValueError(f"{pattern[:40]!r} is no regular expression: {why}") from None
    return pattern


Pattern = Annotated[str, Field(min_length=1, max_length=LONGEST_NAME), AfterValidator(_is_regular)]
Patterns = Annotated[list[Pattern], Field(min_length=1, max_length=MOST_MEMBERS)]
PerName = Annotated[dict[Pattern, Real], Field(max_length=MOST_MEMBERS)]
PATTERNS = "Each is a name, or a regular expression that matches whole names."


def matches(pattern: str, name: str) -> bool:
    """Whether a valid pattern is the name, or matches all of it."""
    return pattern == name or _matcher(pattern).isinstance_python(name)


def matching(patterns: Iterable[str], names: Iterable[str]) -> list[str]:
    """The names that some pattern matches, in their own order. Parts without a name are never matched."""
    matchers = [(pattern, _matcher(pattern)) for pattern in patterns]
    return [
        name
        for name in names
        if name and any(name == pattern or matcher.isinstance_python(name) for pattern, matcher in matchers)
    ]


def matching_in_turn(patterns: Iterable[str], names: Sequence[str]) -> list[str]:
    """The names that the first pattern matches, in their own order, then those of the next one, each once."""
    return list(dict.fromkeys(name for pattern in patterns for name in matching([pattern], names)))


def by_name(values: Mapping[str, _Value], names: Iterable[str]) -> dict[str, _Value]:
    """The value of each name that a pattern matches: that of the first one."""
    chosen = ((name, next((p for p in values if matches(p, name)), None)) for name in names if name)
    return {name: values[pattern] for name, pattern in chosen if pattern is not None}
