"""Base classes of documents: strict for what users send, lenient for what we stored."""

import json
from typing import Any, Self, TypeVar, cast

from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError
from pydantic_core import from_json

AnyDocument = TypeVar("AnyDocument")


class _Value(BaseModel):
    """Immutable, so it needs no copies: pydantic would otherwise copy a default at every use."""

    model_config = ConfigDict(frozen=True)

    def __deepcopy__(self, memo: dict[int, Any] | None = None) -> Self:
        return self


class Strict(_Value):
    """A document from a client: an unknown field is a typo, NaN is a mistake, `"3"` is not a number."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, strict=True)


class Stored(_Value):
    """A document of our own, perhaps of an older or newer version: unknown fields are ignored."""

    model_config = ConfigDict(extra="ignore")


def read_leniently(text: str, adapter: TypeAdapter[AnyDocument]) -> AnyDocument:
    """A stored document of the strict kind, without the fields that this version does not know.

    Raises ValueError where the rest is not valid: a required field is missing, or takes other values now.
    """
    while True:
        try:
            return adapter.validate_json(text)
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
