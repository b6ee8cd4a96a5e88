"""The values along the axes of a sweep: all combinations of a grid, random draws, and steps from a value."""

import math
import random
from collections.abc import Iterator, Mapping, Sequence
from itertools import product

from pydantic import JsonValue

from core.sweeps.spec import DEFAULT_POINTS, Axis, Number, Range, SweepSpec

Values = dict[str, JsonValue]


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
