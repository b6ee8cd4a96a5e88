"""pydantic's errors, as sentences and JSON pointers into the client's own document."""

import math
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from types import MappingProxyType
from typing import Any, cast

from pydantic import TypeAdapter

from core.bounds import MOST_PROBLEMS
from core.environments import catalog
from core.errors import Problem
from core.jobs.spec import JOB_SPEC
from core.nearest import nearest

# Objects lie this deep in a document.
_DEPTH = 2
# Fields below are compared for so many wrong names: each takes milliseconds.
_MAX_PATHS = 5
_VERY_LIKE = 0.8
_NOTHING: Mapping[str, str] = MappingProxyType({})
_CONSTANTS: dict[bool | None, str] = {None: "null", True: "true", False: "false"}
_NOT_FINITE = {"nan": "NaN", "inf": "Infinity", "-inf": "-Infinity"}

Location = tuple[int | str, ...]


def body_problems(
    errors: Iterable[Mapping[str, Any]], document: Any, kind: TypeAdapter[Any] = JOB_SPEC
) -> Sequence[Problem]:
    """One problem for each invalid place, up to fifty. document: what the client sent, parsed; kind: what it
    should be."""
    found: dict[str, list[str]] = {}
    for error in errors:
        place = _place(error, document)
        pointer = _pointer(error, place)
        if pointer not in found and len(found) == MOST_PROBLEMS:
            break
        known = _fields_at(error["loc"][:-1], kind)
        inner = _NOTHING
        if len(found) < _MAX_PATHS and error["type"] == "extra_forbidden":
            inner = {**_paths_below(error["loc"][:-1], kind), **_options(place[:-1], document)}
        found.setdefault(pointer, []).append(_sentence({**error, "loc": place}, known, inner))
    return [Problem(pointer, _joined(sentences)) for pointer, sentences in found.items()]


def parameter_problems(errors: Iterable[Mapping[str, Any]]) -> Sequence[Problem]:
    """The same for parameters of the path and the query; the pointer is `/` and the parameter's name."""
    found: dict[str, list[str]] = {}
    for error in errors:
        name = next((part for part in error["loc"][1:] if isinstance(part, str)), "")
        found.setdefault(f"/{_escaped(name)}", []).append(_sentence({**error, "loc": (name,)}, ()))
    return [Problem(pointer, _joined(sentences)) for pointer, sentences in found.items()]


def shown(value: Any) -> str:
    """Any value as text for a sentence: short, in JSON's notation."""
    match value:
        case None | bool():
            return _CONSTANTS[value]
        case int():
            return str(value) if abs(value) < 10**20 else "an integer of very many digits"
        case float():
            return f"{value:g}" if math.isfinite(value) else _NOT_FINITE[str(value)]
        case str():
            return repr(value if len(value) <= 40 else value[:40] + "…")
        case dict():
            return "an object"
        case _:
            return "an array"


def _place(error: Mapping[str, Any], document: Any) -> Location:
    """The error's place in the client's document, without pydantic's union tags and key marks."""
    place, here = list[int | str](), document
    last = len(error["loc"]) - 1
    for position, part in enumerate(error["loc"]):
        if isinstance(here, dict) and part in here:
            here = cast("dict[Any, Any]", here)[part]
        elif isinstance(here, list) and isinstance(part, int) and part < len(cast("list[Any]", here)):
            here = cast("list[Any]", here)[part]
        elif position < last or error["type"] != "missing":
            continue
        place.append(part)
    return tuple(place)


def _pointer(error: Mapping[str, Any], place: Location) -> str:
    pointer = "".join(f"/{_escaped(part)}" for part in place)
    if error["type"].startswith("union_tag"):
        pointer += f"/{_discriminator(error)}"
    return pointer


def _sentence(error: Mapping[str, Any], known: Sequence[str], inner: Mapping[str, str] = _NOTHING) -> str:
    """known: the fields at this place. inner: paths of fields below it, by their last part."""
    name = _name(error["loc"])[:60]
    match error["type"]:
        case "extra_forbidden":
            return f"`{name}` is not a field here{_hint(name, known, inner)}"
        case "missing" if isinstance(error["loc"][-1], int):
            return f"`{name}` has too few items: item {error['loc'][-1]}, counted from 0, is missing."
        case "missing":
            return f"`{name}` is missing."
        case "union_tag_not_found":
            return f"`{_discriminator(error)}` is missing; it says what the object is."
        case "union_tag_invalid":
            tags = [tag.strip(" '") for tag in error["ctx"]["expected_tags"].split(",")]
            tag = str(error["ctx"]["tag"])
            return f"`{_discriminator(error)}` is {shown(tag)}{_hint(tag, tags)}"
        case "too_short":
            least, items = error["ctx"]["min_length"], error["ctx"]["actual_length"]
            return (
                f"`{name}` needs at least {least} item{'' if least == 1 else 's'}, and has {items or 'none'}."
            )
        case "too_long":
            return _too_long(name, error, len(error["input"]), "items")
        case "string_too_long":
            return _too_long(name, error, len(error["input"]), "characters")
        case "string_pattern_mismatch":
            return f"`{name}` must match {error['ctx']['pattern']}, not be {shown(error['input'])}."
        case _:
            words = str(error["msg"]).removeprefix("Value error, ").replace("Input should be", "must be")
            but = f", not {shown(error['input'])}" if words.startswith("must be") else ""
            return f"`{name}`: {words[0].lower()}{words[1:]}{but}."


def _too_long(name: str, error: Mapping[str, Any], found: int, parts: str) -> str:
    return f"`{name}` has {found:,} {parts}; at most {error['ctx']['max_length']:,} are allowed."


def _name(location: Location) -> str:
    return next((part for part in reversed(location) if isinstance(part, str) and part != "[key]"), "body")


def _discriminator(error: Mapping[str, Any]) -> str:
    return str(error["ctx"]["discriminator"]).strip("'")


def _hint(wrong: str, known: Sequence[str], inner: Mapping[str, str] = _NOTHING) -> str:
    if wrong in inner:
        return f"; did you mean `{inner[wrong]}`?"
    if (near := nearest(wrong, inner, cutoff=_VERY_LIKE)) and not nearest(wrong, known, cutoff=_VERY_LIKE):
        return f"; did you mean `{inner[near[0]]}`?"
    if near := nearest(wrong, known, cutoff=0.5):
        return f"; did you mean `{near[0]}`?"
    return f"; known are {', '.join(f'`{name}`' for name in known)}." if known else "."


def _joined(sentences: Sequence[str]) -> str:
    return " Or: ".join(dict.fromkeys(sentences))


def _escaped(part: object) -> str:
    return str(part).replace("~", "~0").replace("/", "~1")


@cache
def _schema(kind: TypeAdapter[Any]) -> dict[str, Any]:
    return kind.json_schema()


def _fields_at(location: Location, kind: TypeAdapter[Any]) -> Sequence[str]:
    """The fields that an object at this place may have; pydantic's union tags select its type."""
    return list(_node_at(location, kind).get("properties", {}))


@cache
def _paths_below(location: Location, kind: TypeAdapter[Any]) -> Mapping[str, str]:
    """The paths of fields in the objects below this place, by their last part; shorter paths win."""
    found, level = dict[str, str](), [("", _node_at(location, kind))]
    for _ in range(_DEPTH):
        inner = [
            (f"{path}{name}.", form)
            for path, node in level
            for name, field in node.get("properties", {}).items()
            for form in _objects(field, _schema(kind))
        ]
        for path, node in inner:
            for name in node.get("properties", {}):
                found.setdefault(name, f"{path}{name}")
        level = inner
    return found


def _options(location: Location, document: Any) -> Mapping[str, str]:
    """The paths of the options of the environment that the object at this place names, if it does."""
    here = document
    for part in location:
        here = here[part]
    chosen = cast("dict[str, Any]", here).get("environment") if isinstance(here, dict) else None
    name = cast("dict[str, Any]", chosen).get("id") if isinstance(chosen, dict) else chosen
    info = catalog.ENVIRONMENTS.get(name) if isinstance(name, str) else None
    fields = () if info is None else info.options.model_fields
    return {field: f"environment.options.{field}" for field in fields}


def _node_at(location: Location, kind: TypeAdapter[Any]) -> dict[str, Any]:
    schema = _schema(kind)
    node = schema
    for part in location:
        node = _object(node, schema)
        mapping = node.get("discriminator", {}).get("mapping", {})
        node = {"$ref": mapping[part]} if part in mapping else node.get("properties", {}).get(part, {})
    return _object(node, schema)


def _objects(node: dict[str, Any], schema: dict[str, Any]) -> Sequence[dict[str, Any]]:
    """Every form of the node that is an object."""
    forms = node.get("oneOf", node.get("anyOf", [node]))
    return [_object(form, schema) for form in forms if "$ref" in form]


def _object(node: dict[str, Any], schema: dict[str, Any]) -> dict[str, Any]:
    """The node with its reference resolved; of several forms, the one that is an object."""
    if "$ref" in node:
        return _object(schema["$defs"][node["$ref"].rpartition("/")[2]], schema)
    if "anyOf" in node:
        forms = (_object(form, schema) for form in node["anyOf"] if "$ref" in form)
        return next(forms, dict[str, Any]())
    return node
