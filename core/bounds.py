"""How large what users send may be: the bounds that several documents share, and what holds them.

Each stands in the OpenAPI document, or in the schema of an import's document. Other bounds stand in the one
field that they are for.
"""

import json
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, cast

from pydantic import AfterValidator, Field, JsonValue

from core.errors import Problem, Rejected

# These hold for every object and list. No field needs more members than 64 labels or 64 axes.
MOST_MEMBERS = 64
MOST_ITEMS = 10_000
DEEPEST = 32
# Places that a refusal names.
MOST_PROBLEMS = 50
# Characters of a name, of a sentence for people, of an address of ours.
LONGEST_NAME = 200
LONGEST_MESSAGE = 4_000
# Characters of what people note about a job or a sweep.
LONGEST_NOTE = 4_000
# The name of a user or a project, as a regular expression.
ACCOUNT_NAME = r"[a-z0-9][a-z0-9._@-]{0,62}"
# A job's specification in JSON. Listings carry it.
LARGEST_JOB_BYTES = 2**17
# JSON of what an attempt or a file says about itself.
LARGEST_FACTS_BYTES = 2**16
# The values of an axis of a sweep.
LARGEST_AXIS_BYTES = 2**18
# Beyond all lengths, angles and weights, and within float32.
LARGEST_NUMBER = 1e30
LARGEST_STEP = 10**18
MOST_ATTEMPTS = 200
# Metrics in a row, and in all rows of a job.
MOST_IN_A_ROW = 500
MOST_METRICS = 2_000
MOST_FILES = 10_000
# Numbers of an observation.
MOST_OBSERVED = 50_000

Real = Annotated[float, Field(ge=-LARGEST_NUMBER, le=LARGEST_NUMBER)]
PastStep = Annotated[int, Field(ge=0, le=LARGEST_STEP)]


def within(most: int) -> tuple[Any, ...]:
    """For a type whose form is another's to check: at most so many bytes as JSON, which its schema says."""

    def check(value: Any) -> Any:
        if (size := json_bytes(value)) > most:
            raise ValueError(f"has {size:,} bytes as JSON; at most {most:,} are allowed")
        return value

    return AfterValidator(check), Field(json_schema_extra={"x-maxBytes": most})


_Free = Annotated[dict[str, Any], Field(max_length=MOST_ITEMS)]
Facts = Annotated[_Free, *within(LARGEST_FACTS_BYTES)]
JobDocument = Annotated[_Free, *within(LARGEST_JOB_BYTES)]
# An environment's own model checks them.
FreeOptions = Annotated[
    dict[Annotated[str, Field(max_length=LONGEST_NAME)], JsonValue],
    Field(max_length=MOST_MEMBERS),
    *within(LARGEST_JOB_BYTES),
]


def json_bytes(value: Any) -> int:
    return len(
        json.dumps(value, ensure_ascii=False, separators=(",", ":"), default=str).encode("utf-8", "replace")
    )


def check_extent(document: Any) -> None:
    """Refuse a document with an object, a list or a depth beyond all bounds, before it is validated.

    The time and the memory of a validation grow with the number of wrong places. Raises Rejected.
    """
    waiting: list[tuple[Any, tuple[str, ...]]] = [(document, ())]
    while waiting:
        here, place = waiting.pop()
        if isinstance(here, dict):
            members = cast("Mapping[str, Any]", here)
            _check_number(len(members), MOST_MEMBERS, "an object", "members", place)
            inside: list[tuple[str, Any]] = list(members.items())
        elif isinstance(here, list):
            items = cast("Sequence[Any]", here)
            _check_number(len(items), MOST_ITEMS, "a list", "items", place)
            inside = [
                (str(number), item) for number, item in enumerate(items) if isinstance(item, dict | list)
            ]
        else:
            continue
        _check_number(len(place), DEEPEST, "a document", "levels", place)
        waiting += [(value, (*place, name)) for name, value in inside if isinstance(value, dict | list)]


def _check_number(found: int, most: int, what: str, parts: str, place: Sequence[str]) -> None:
    if found > most:
        name = place[-1][:60] if place else "body"
        detail = f"`{name}` has {found:,} {parts}; {what} has {most:,} at most."
        pointer = "".join(f"/{part[:60].replace('~', '~0').replace('/', '~1')}" for part in place)
        raise Rejected(detail, [Problem(pointer, detail)])
