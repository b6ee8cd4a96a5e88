"""The values along the axes of a sweep: all combinations of a grid, random draws, and steps from a value.

An axis is a field of the job, named by its path, such as `algorithm.learning_rate`.
"""

import math
import random
from collections.abc import Iterable, Iterator, Mapping, Sequence
from copy import deepcopy
from itertools import product
from typing import Any, get_args

from pydantic import BaseModel, JsonValue

from core.environments.info import EnvironmentInfo
from core.jobs.spec import JOB_SPEC, JobSpec
from core.sweeps.spec import DEFAULT_POINTS, Axis, Number, Range, SweepSpec

Values = dict[str, JsonValue]
_FIXED = ("kind", "name", "labels", "note")
_OPTIONS = "environment.options"


def grid_values(axis: Axis) -> list[JsonValue]:
    """The values of a grid along the axis."""
    if not isinstance(axis, Range):
        return axis
    if axis.step is not None:
        return [_along(axis, number) for number in range(_num_steps(axis) + 1)]
    points = axis.points or DEFAULT_POINTS
    found = [_between(axis, number / (points - 1) if points > 1 else 0.5) for number in range(points)]
    return list(dict.fromkeys(found))  # Few whole numbers may lie between the bounds.


def num_combinations(parameters: Mapping[str, Axis]) -> int:
    """The size of a grid, counted without making the values, which may be very many."""
    return math.prod(map(_num_values, parameters.values()))


def _num_values(axis: Axis) -> int:
    if isinstance(axis, Range) and axis.step is not None:
        return _num_steps(axis) + 1
    return len(grid_values(axis))


def combinations(parameters: Mapping[str, Axis]) -> Iterator[Values]:
    """All combinations of a grid; the last axis changes first."""
    columns = [grid_values(axis) for axis in parameters.values()]
    return (dict(zip(parameters, row, strict=True)) for row in product(*columns))


def random_values(spec: SweepSpec, number: int) -> Values:
    """The values of trial `number`; they depend on this number, the sweep's seed and the axes alone."""
    drawn = Values()
    for name, axis in spec.parameters.items():
        generator = random.Random(f"{spec.seed}/{number}/{name}")  # noqa: S311 # Not for secrets.
        drawn[name] = value_at(axis, generator.random())
    return drawn


def corners(parameters: Mapping[str, Axis]) -> Iterator[Values]:
    """Every value at an axis's end, and every choice, while the other axes stay at their first value."""
    found = {name: ends(axis) for name, axis in parameters.items()}
    first = {name: values[0] for name, values in found.items()}
    for name, values in found.items():
        yield from ({**first, name: value} for value in values)
    yield {name: values[-1] for name, values in found.items()}


def ends(axis: Axis) -> list[JsonValue]:
    """Both bounds of a range; all choices."""
    return [axis.low, axis.high] if isinstance(axis, Range) else axis


def value_at(axis: Axis, share: float) -> JsonValue:
    """The value at this share of the axis, in [0, 1); shares that are even give values that are."""
    if not isinstance(axis, Range):
        return axis[int(share * len(axis))]
    if axis.step is not None:
        return _along(axis, int(share * (_num_steps(axis) + 1)))
    if axis.is_whole and not axis.log:
        return int(axis.low) + int(share * (int(axis.high) - int(axis.low) + 1))
    return _between(axis, share)


def has_one_value(axis: Range) -> bool:
    """Whether its step leads past the upper bound at once."""
    return axis.step is not None and _num_steps(axis) == 0


def scaled(axis: Range, value: Number, factor: float) -> Number:
    """The value times the factor, within the range; whole numbers and steps move by one step at least."""
    wanted = value * factor
    step = axis.step or (1 if axis.is_whole else None)
    if step is None:
        return min(max(wanted, axis.low), axis.high)
    before, after = (round((one - axis.low) / step) for one in (value, wanted))
    if after == before:
        after += (wanted > value) - (wanted < value)
    return _along(axis, min(max(after, 0), _num_steps(axis)))


def neighbours(choices: Sequence[JsonValue], value: JsonValue) -> list[JsonValue]:
    """The choices beside this one; itself where there is no other."""
    at = position(choices, value)
    return [choices[other] for other in (at - 1, at + 1) if 0 <= other < len(choices)] or [value]


def position(choices: Sequence[JsonValue], value: JsonValue) -> int:
    """The index of the value among the choices; it compares types, because `true == 1` in Python."""
    return next(at for at, one in enumerate(choices) if type(one) is type(value) and one == value)


def last_value(axis: Range) -> Number:
    """The greatest value along the axis: the last step may end before the upper bound."""
    return axis.high if axis.step is None else _along(axis, _num_steps(axis))


def _num_steps(axis: Range) -> int:
    """Steps between the bounds, for which rounding must not cost the last one."""
    return math.floor((axis.high - axis.low) / (axis.step or 1) + 1e-9)


def _along(axis: Range, number: int) -> Number:
    step = axis.step or 1
    return axis.low + number * step if axis.is_whole else float(f"{axis.low + number * step:.12g}")


def _between(axis: Range, share: float) -> Number:
    """The value at this share of the way from the lower bound to the upper one."""
    if share in (0, 1):  # Exactly: rounding might leave the range.
        return (axis.low, axis.high)[int(share)]
    if axis.log:
        value = math.exp((1 - share) * math.log(axis.low) + share * math.log(axis.high))
    else:
        value = (1 - share) * axis.low + share * axis.high
    value = min(max(value, axis.low), axis.high)
    return round(value) if axis.is_whole else value


def fields_of(spec: JobSpec, info: EnvironmentInfo) -> dict[str, Any]:
    """The annotation of every field of the job, its algorithm and its environment's options, by path.

    `kind` is left out, because it says what the other fields are; so are `name` and `labels`, which change
    no result.
    """
    found = _fields(spec, "") | _fields(info.option_values, f"{_OPTIONS}.")
    return {name: annotation for name, annotation in found.items() if name not in _FIXED}


def with_whole_parts(spec: JobSpec, info: EnvironmentInfo, names: Iterable[str]) -> JobSpec:
    """The job that says every field of each object in its environment's options in which an axis changes one.

    Otherwise the object's other fields would have the defaults of its kind, and not those of the environment.
    info: the environment's row under the job's options. names: of the axes.
    """
    options: dict[str, Any] = deepcopy(dict(spec.environment.options))
    for name in names:
        if not name.startswith(f"{_OPTIONS}."):
            continue
        # Another kind of an object has other fields.
        *above, _ = name.removeprefix(f"{_OPTIONS}.").removesuffix(".kind").split(".")
        place, values = options, info.option_values
        for part in above:
            values = getattr(values, part)
            if not isinstance(place.get(part), dict):
                place[part] = values.model_dump(mode="json")
            place = place[part]
    if options == spec.environment.options:
        return spec
    environment = spec.environment.model_copy(update={"options": options})
    return spec.model_copy(update={"environment": environment})


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
