"""Boxes that never move, of which a geom is near one at most: the floor of a corridor, platform by platform.

One contact serves them all: the box that the geom is near is chosen while the program runs. So a corridor
costs as much as the few boxes that a geom can touch at once, and not as much as all that there are.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import and_

import mujoco

from mujoco_compiled.collisions.own_boxes import OwnBoxes
from mujoco_compiled.collisions.shapes import Geom, Placed
from mujoco_compiled.constraints.pairs import ContactParameters, Pair
from mujoco_compiled.program.arithmetic import (
    Matrix,
    Number,
    Vector,
    absolute,
    rotate,
    select,
    subtract,
    transpose,
)

_BOX = int(mujoco.mjtGeom.mjGEOM_BOX)
_TURNED = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]


@dataclass(frozen=True)
class Choice:
    """Boxes with the same axes. numbers: of the geoms. centres: in those axes, [3] in m. reach: from a geom's
    centre to what it can touch, in m; no two boxes are within reach at once.

    bound: the largest one's, see `Geom`. parameters: of the contact with each; they differ where environments
    have their own.
    """

    numbers: tuple[int, ...]
    parameters: tuple[ContactParameters, ...]
    rotation: Matrix
    centres: tuple[Vector, ...]
    sizes: tuple[Vector, ...]
    reach: float
    bound: float
    kind: int = _BOX
    body: int = 0


Shape = Geom | Choice


def merged(
    pairs: Sequence[Pair], nominal: Sequence[ContactParameters], geoms: Sequence[Geom], own: OwnBoxes | None
) -> list[tuple[Pair, Shape]]:
    """The pairs, each with its second geom; pairs of one geom with fixed boxes as few choices.

    nominal: the pairs' parameters by the model's own numbers; those of a choice are the same. own: see
    `own_boxes`.
    """
    groups: dict[object, list[Pair]] = {}
    for place, (given, parameters) in enumerate(zip(pairs, nominal, strict=True)):
        pair = _fixed_last(given, geoms)
        other = geoms[pair.other]
        is_fixed_box = other.kind == _BOX and not other.body
        alike = (pair.one, parameters, str(other.rotation)) if is_fixed_box else place
        groups.setdefault(alike, []).append(pair)
    found = list[tuple[Pair, Shape]]()
    for group in groups.values():
        for part in _apart(group, geoms, own) if len(group) > 1 else [group]:
            found.append((part[0], _choice(part, geoms) if len(part) > 1 else geoms[part[0].other]))
    return found


def near(choice: Choice, centre: Vector) -> Vector:
    """For each box but the first: whether a geom with this centre [3] is near it, and so near no other."""
    here = rotate(transpose(choice.rotation), centre)
    boxes = list(zip(choice.centres, choice.sizes, strict=True))
    # Boxes that are apart differ in one direction at least.
    varying = [k for k in range(3) if _differ([(middle[k], size[k]) for middle, size in boxes])]
    return [
        reduce(and_, (absolute(here[k] - middle[k]) < size[k] + choice.reach for k in varying))
        for middle, size in boxes[1:]
    ]


def chosen_box(choice: Choice, is_near: Vector) -> Placed:
    """The box that a geom is near; any of them, where it is near none."""
    position, size = (
        [_chosen(is_near, numbers) for numbers in zip(*vectors, strict=True)]
        for vectors in (choice.centres, choice.sizes)
    )
    return Placed(rotate(choice.rotation, position), _TURNED, choice.rotation, size)


def chosen_parameters(choice: Choice, is_near: Vector) -> ContactParameters:
    """The parameters of the contact with the box that a geom is near."""
    springs = [one.spring for one in choice.parameters]
    spring = replace(
        springs[0],
        stiffness=_chosen(is_near, [one.stiffness for one in springs]),
        damping=_chosen(is_near, [one.damping for one in springs]),
    )
    frictions = zip(*(one.friction for one in choice.parameters), strict=True)
    return replace(
        choice.parameters[0],
        friction=tuple(_chosen(is_near, numbers) for numbers in frictions),
        spring=spring,
        friction_damping=_chosen(is_near, [one.friction_damping for one in choice.parameters]),
    )


def _chosen(is_near: Vector, numbers: Sequence[Number]) -> Number:
    """The number that belongs to the box that is near. numbers: one of each box."""
    found = numbers[0]
    if not all(isinstance(number, float) and number == found for number in numbers):
        for condition, number in zip(is_near, numbers[1:], strict=True):
            found = select(condition, number, found)
    return found


def _differ(numbers: Sequence[tuple[Number, Number]]) -> bool:
    """Whether boxes differ along an axis, or may; numbers: place and size of each."""
    return any(not isinstance(x, float) for pair in numbers for x in pair) or len(set(numbers)) > 1


def _fixed_last(pair: Pair, geoms: Sequence[Geom]) -> Pair:
    """The pair, turned round if a box that never moves is the first of two: the order changes no row."""
    one, other = geoms[pair.one], geoms[pair.other]
    turns_round = one.kind == other.kind == _BOX and not one.body
    return replace(pair, one=pair.other, other=pair.one) if turns_round else pair


def _choice(pairs: Sequence[Pair], geoms: Sequence[Geom]) -> Choice:
    boxes = [geoms[pair.other] for pair in pairs]
    rotation = boxes[0].rotation
    centres = tuple(rotate(transpose(rotation), box.position) for box in boxes)
    return Choice(
        numbers=tuple(pair.other for pair in pairs),
        parameters=tuple(pair.parameters for pair in pairs),
        rotation=rotation,
        centres=centres,
        sizes=tuple(box.size for box in boxes),
        reach=_reach(pairs[0], geoms),
        bound=max(box.bound for box in boxes),
    )


def _apart(pairs: Sequence[Pair], geoms: Sequence[Geom], own: OwnBoxes | None) -> list[list[Pair]]:
    """The pairs in a few lists; in a list, the geom is never near two of the boxes."""
    if own:
        number = own.most_in_reach(_reach(pairs[0], geoms))
        return [list(pairs[first::number]) for first in range(min(number, len(pairs)))]
    found = list[list[Pair]]()
    for pair in pairs:
        for part in found:
            if not any(_are_near(pair, other, geoms) for other in part):
                part.append(pair)
                break
        else:
            found.append([pair])
    return found


def _are_near(one: Pair, other: Pair, geoms: Sequence[Geom]) -> bool:
    """Whether the geom, which both have, can be within reach of both boxes at once."""
    box, box_other = geoms[one.other], geoms[other.other]
    way = rotate(transpose(box.rotation), subtract(box.position, box_other.position))
    sizes = zip(way, box.size, box_other.size, strict=True)
    return all(abs(x) <= a + b + 2.0 * _reach(one, geoms) for x, a, b in sizes)


def _reach(pair: Pair, geoms: Sequence[Geom]) -> float:
    return geoms[pair.one].bound + max(0.0, pair.parameters.reach)
