"""Contacts that compute nothing while their geoms are apart."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import islice

from mujoco_compiled.collisions.shapes import AWAY, Touch
from mujoco_compiled.constraints.body_rows import BodyGroup
from mujoco_compiled.constraints.laws import RowGroup, with_stiffness
from mujoco_compiled.program.arithmetic import Number, Vector
from mujoco_compiled.program.flow import nothing, where_needed


def touches_where(is_close: Number, collide: Callable[[], Sequence[Touch]]) -> list[Touch]:
    """The touches where the condition is true; elsewhere they are far apart."""
    touches = list[Touch]()

    def numbers() -> Vector:
        touches.extend(collide())
        others = (number for one in touches for number in (*one.position, *one.normal, *(one.along or ())))
        return [*(one.distance for one in touches), *others]

    def apart(values: Vector) -> Vector:
        others = (value if isinstance(value, float) else 0.0 for value in values[len(touches) :])
        return [*([AWAY] * len(touches)), *others]

    values = where_needed(is_close, numbers, apart)
    left = iter(values[len(touches) :])
    return [
        replace(
            one,
            distance=distance,
            position=_next(left, one.position),
            normal=_next(left, one.normal),
            along=None if one.along is None else _next(left, one.along),
        )
        for one, distance in zip(touches, values, strict=False)
    ]


def groups_where(
    may_push: Number, make: Callable[[], Sequence[RowGroup | BodyGroup]]
) -> list[RowGroup | BodyGroup]:
    """The groups of a contact where the condition is true; elsewhere their numbers are 0."""
    groups = list[RowGroup | BodyGroup]()

    def numbers() -> Vector:
        groups.extend(make())
        return [number for group in groups for number in _numbers(group)]

    left = iter(where_needed(may_push, numbers, nothing))
    return [_renewed(group, left, may_push) for group in groups]


def _numbers(group: RowGroup | BodyGroup) -> Vector:
    directions = (
        [list(one.values()) for one in group.directions] if isinstance(group, RowGroup) else group.wrenches
    )
    return [*(number for one in directions for number in one), *group.reference, group.law.stiffness]


def _renewed(group: RowGroup | BodyGroup, left: Iterator[Number], may_push: Number) -> RowGroup | BodyGroup:
    """The group with numbers in the order of `_numbers`."""
    if isinstance(group, BodyGroup):
        group = replace(group, wrenches=[_next(left, wrench) for wrench in group.wrenches])
    else:
        directions = [dict(zip(one, _next(left, one), strict=True)) for one in group.directions]
        group = replace(group, directions=directions)
    reference, law = _next(left, group.reference), group.law
    return replace(group, reference=reference, law=with_stiffness(law, next(left)), may_push=may_push)


def _next(left: Iterator[Number], like: Sequence[Number] | dict[int, Number]) -> Vector:
    """As many numbers as this has."""
    return list(islice(left, len(like)))
