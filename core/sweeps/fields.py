"""The fields of a job by their paths, such as `algorithm.learning_rate`, and a job with others in them."""

from collections.abc import Mapping
from typing import Any, get_args

from pydantic import BaseModel, JsonValue

from core.environments.info import EnvironmentInfo
from core.jobs.spec import JOB_SPEC, JobSpec

_FIXED = ("kind", "name", "labels")
_OPTIONS = "environment.options"


def fields_of(spec: JobSpec, info: EnvironmentInfo) -> dict[str, Any]:
    """The annotation of every field of the job, its algorithm and its environment's options, by path.

    `kind` is left out, because it says what the other fields are; so are `name` and `labels`, which change
    no result.
    """
    found = _fields(spec, "")
    options = {f"{_OPTIONS}.{name}": field.annotation for name, field in info.options.model_fields.items()}
    return {name: annotation for name, annotation in {**found, **options}.items() if name not in _FIXED}


def _fields(model: BaseModel, prefix: str) -> dict[str, Any]:
    found = dict[str, Any]()
    for name, field in type(model).model_fields.items():
        found[f"{prefix}{name}"] = field.annotation
        value = getattr(model, name)
        if isinstance(value, BaseModel):
            found |= _fields(value, f"{prefix}{name}.")
    return found


def takes_fractions(annotation: Any) -> bool:
    """Whether a field of this annotation takes numbers that are not whole."""
    return annotation is float or any(takes_fractions(one) for one in get_args(annotation))


def job_of(spec: JobSpec, values: Mapping[str, JsonValue]) -> JobSpec:
    """The job with other values at these paths. Raises ValidationError."""
    return JOB_SPEC.validate_python(with_values(spec, values))


def axis_place(path: str) -> str:
    """The pointer to the axis of this field in a sweep's document."""
    return f"/parameters/{path.replace('~', '~0').replace('/', '~1')}"


def with_values(spec: JobSpec, values: Mapping[str, JsonValue]) -> dict[str, Any]:
    """The job as a document, with other values at these paths."""
    document = _document(spec)
    for path, value in values.items():
        *above, last = path.split(".")
        place = document
        for part in above:
            place = place.setdefault(part, {})
        place[last] = value
    return document


def _document(spec: JobSpec) -> dict[str, Any]:
    sent: dict[str, Any] = JOB_SPEC.dump_python(spec, mode="json", exclude_unset=True)
    return {"kind": spec.kind, **sent}
