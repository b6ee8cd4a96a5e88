"""The name, labels and note of a job or a sweep: what people call it and say of it.

They stand in its specification, and may change at any time: no run is steered by them.
"""

from collections.abc import Mapping
from typing import Any, cast

from pydantic import Field, TypeAdapter

from core.bounds import LARGEST_JOB_BYTES, json_bytes
from core.documents import Strict
from core.errors import Problem, Rejected
from core.jobs.spec import MOST_LABELS, LabelName, Note, Text


class JobPatch(Strict):
    """What changes, as a JSON merge patch (RFC 7396): what is left out stays, and null removes."""

    name: Text | None = Field(default=None, examples=["softer knees"])
    labels: dict[LabelName, Text | None] | None = Field(
        default=None,
        max_length=MOST_LABELS,
        description="Those that change; null removes one.",
        examples=[{"team": "legs", "draft": None}],
    )
    note: Note | None = None


JOB_PATCH: TypeAdapter[JobPatch] = TypeAdapter(JobPatch)


def patched(spec: Mapping[str, Any], patch: JobPatch) -> dict[str, Any]:
    """A job's specification, as JSON, under the patch. Raises Rejected where it would be too large."""
    changed = merged(spec, patch)
    if (number := len(changed.get("labels", {}))) > MOST_LABELS:
        _refuse(f"The job would have {number} labels; at most {MOST_LABELS} are allowed.", "/labels")
    if changed != spec and (size := json_bytes(changed)) > LARGEST_JOB_BYTES:
        _refuse(f"The job would have {size:,} bytes as JSON; at most {LARGEST_JOB_BYTES:,} are allowed.", "")
    return changed


def merged(spec: Mapping[str, Any], patch: JobPatch) -> dict[str, Any]:
    """A specification of a job or a sweep, as JSON, under the patch."""
    changes = patch.model_dump(exclude_unset=True)
    if changes.get("labels") is not None:
        # A record that cannot be read may have anything in their place.
        had = cast("dict[str, Any]", spec["labels"]) if isinstance(spec.get("labels"), dict) else {}
        labels: dict[str, Any] = {**had, **changes["labels"]}
        changes["labels"] = {name: value for name, value in labels.items() if value is not None}
    removed = {name for name, value in changes.items() if value is None}
    return {name: value for name, value in {**spec, **changes}.items() if name not in removed}


def _refuse(detail: str, pointer: str) -> None:
    raise Rejected(detail, [Problem(pointer, detail)])
