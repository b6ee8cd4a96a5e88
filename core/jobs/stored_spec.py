"""Reads a stored specification leniently: another version may have written it."""

import json
from typing import Any, cast

from pydantic import ValidationError
from pydantic_core import from_json

from core.jobs.spec import JOB_SPEC, JobSpec


def read_spec(text: str) -> JobSpec:
    """The specification without the fields that this version does not know.

    Raises ValueError where the rest is not valid: a required field is missing, or takes other values now.
    """
    while True:
        try:
            return JOB_SPEC.validate_json(text)
        except ValidationError as error:
            unknown = [found["loc"] for found in error.errors() if found["type"] == "extra_forbidden"]
            document = from_json(text)
            if not any([_drop(document, location) for location in unknown]):
                raise
            text = json.dumps(document)


def _drop(document: Any, location: tuple[int | str, ...]) -> bool:
    """Remove the field at this location; whether it was there.

    pydantic puts the kind of a union's member before the member's fields, and adds other words of its own:
    these are not in the document and are skipped.
    """
    place, is_entered = document, True
    for step in location[:-1]:
        if is_entered and _kind(place) == step:
            is_entered = False  # Perhaps there is also a field of that name.
            continue
        try:
            place, is_entered = place[step], True
        except (KeyError, IndexError, TypeError):
            continue
    return isinstance(place, dict) and cast("dict[Any, Any]", place).pop(location[-1], place) is not place


def _kind(place: Any) -> Any:
    return cast("dict[Any, Any]", place).get("kind") if isinstance(place, dict) else None
