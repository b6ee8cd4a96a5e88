"""Everything that a request may hold has a bound, and the OpenAPI document says it."""

import re
from collections.abc import Iterator
from typing import Any, cast

import pytest
from pydantic import BaseModel

from api.app import interface
from api.openapi import describe
from api.sharing import archive
from core.environments.catalog import ENVIRONMENTS

Schema = dict[str, Any]
_COMBINED = ("anyOf", "oneOf", "allOf")
# Of no certain length.
_OPEN_PATTERN = re.compile(r"(?<!\\)[*+]|\{\d+,\}")
_OF_A_VALUE = ("maxLength", "pattern", "format", "maxItems", "maxProperties", "x-maxBytes")


class Walk:
    """Goes through a schema, and collects the places that have no bound."""

    def __init__(self, definitions: Schema) -> None:
        self._definitions = definitions
        self._seen = set[str]()
        self.unbounded = list[str]()
        self.num_seen = 0

    def look(self, schema: Schema, place: str) -> None:
        self.num_seen += 1
        if "$ref" in schema:
            name = schema["$ref"].rpartition("/")[2]
            if name not in self._seen:
                self._seen.add(name)
                self.look(self._definitions[name], name)
        elif members := [one for word in _COMBINED for one in schema.get(word, ())]:
            said = {word: schema[word] for word in _OF_A_VALUE if word in schema}
            for member in members:
                self.look({**said, **member}, place)
        elif not ({"const", "enum"} & set(schema)):
            self.unbounded += [f"{place}: {why}" for why in self._missing(schema, place)]

    def _missing(self, schema: Schema, place: str) -> Iterator[str]:  # noqa: C901 # A table.
        match schema.get("type"):
            case "string":
                pattern = schema.get("pattern")
                is_bounded = schema.get("format") in ("date-time",) or "maxLength" in schema
                if not is_bounded and (pattern is None or _OPEN_PATTERN.search(pattern)):
                    yield "a string without maxLength"
            case "array":
                if "maxItems" not in schema:
                    yield "an array without maxItems"
                if "x-maxBytes" in schema:
                    return
                for item in schema.get("prefixItems", [schema.get("items", {})]):
                    self.look(item, f"{place}[]")
            case "object":
                for name, member in schema.get("properties", {}).items():
                    self.look(member, f"{place}.{name}")
                yield from self._missing_of_free_members(schema, place)
            case "integer" | "number":
                if not all(
                    {word, f"exclusive{word.capitalize()}"} & set(schema) for word in ("minimum", "maximum")
                ):
                    yield "a number without two bounds"
            case "boolean" | "null":
                pass
            case kind:
                yield f"of the type {kind}"

    def _missing_of_free_members(self, schema: Schema, place: str) -> Iterator[str]:
        values = [schema.get("additionalProperties"), *schema.get("patternProperties", {}).values()]
        is_free = "properties" not in schema or any(isinstance(value, dict) for value in values)
        if values[0] is False or not is_free:
            return
        if "maxProperties" not in schema:
            yield "an object without maxProperties"
        if "x-maxBytes" in schema:  # Of any form, and so many bytes in all.
            return
        for value in values:
            if isinstance(value, dict):
                self.look(cast("Schema", value), f"{place}{{}}")
            elif value is True:
                yield "an object of any values without x-maxBytes"
        if not schema.get("patternProperties"):
            self.look({"type": "string", **schema.get("propertyNames", {})}, f"{place}{{name}}")


def test_every_parameter_and_every_field_of_every_body_has_a_bound() -> None:
    document = describe(interface())
    walk = Walk(document["components"]["schemas"])
    bodies = 0
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            here = f"{method.upper()} {path}"
            for parameter in operation.get("parameters", ()):
                walk.look(parameter["schema"], f"{here} ?{parameter['name']}")
            for media_type, said in operation.get("requestBody", {}).get("content", {}).items():
                bodies += 1
                walk.look(said["schema"], f"{here} {media_type}")
                if "maxLength" not in said["schema"] and "x-maxBytes" not in operation["requestBody"]:
                    walk.unbounded.append(f"{here}: a body without a limit")
    assert walk.unbounded == []
    assert bodies == 28
    assert walk.num_seen > 300  # It went into the documents.


def test_every_option_of_every_environment_has_a_bound() -> None:
    for info in ENVIRONMENTS.values():
        schema = info.options.model_json_schema()
        walk = Walk(schema.get("$defs", {}))
        walk.look(schema, info.id)
        assert walk.unbounded == []


@pytest.mark.parametrize(
    "kind", [archive.Contents, archive.ArchiveFormat, archive.Record, archive.ArchiveRow, archive.Versions]
)
def test_every_field_of_the_documents_of_an_import_has_a_bound(kind: type[BaseModel]) -> None:
    """H2, H3: those of the record and of the metrics had none."""
    schema = kind.model_json_schema()
    walk = Walk(schema.get("$defs", {}))
    walk.look(schema, kind.__name__)
    assert walk.unbounded == []


def test_a_missing_bound_is_found() -> None:
    walk = Walk({})
    walk.look(
        {
            "type": "object",
            "properties": {
                "a": {"type": "string", "pattern": "^a*$"},
                "b": {"type": "array", "items": {"type": "number", "minimum": 0}},
                "c": {"type": "object", "additionalProperties": True},
                "d": {"anyOf": [{"type": "string"}, {"type": "null"}], "maxLength": 3},
                "e": {},
            },
        },
        "x",
    )
    found = [one.partition(":")[0] for one in walk.unbounded]
    assert sorted(found) == ["x.a", "x.b", "x.b[]", "x.c", "x.c", "x.c{name}", "x.e"]
