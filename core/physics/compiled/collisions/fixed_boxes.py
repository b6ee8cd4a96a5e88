"""Boxes that never move, of which a geom is near one at most: the floor of a corridor, platform by platform.

One contact serves them all: the box that the geom is near is chosen while the program runs. So a corridor
costs as much as the few boxes that a geom can touch at once, and not as much as all that there are.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco

from core.physics.compiled.arithmetic import Matrix, Vector, absolute, rotate, select, subtract, transpose
from core.physics.compiled.collisions.shapes import Geom, Placed
from core.physics.compiled.pairs import Pair

_BOX = int(mujoco.mjtGeom.mjGEOM_BOX)
_TURNED = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]


@dataclass(frozen=True)
class Choice:
    """Boxes with the same axes. centres: in those axes, [3] in m. reach: from a geom's centre to what it can
    touch, in m; no two boxes are within reach at once."""

    rotation: Matrix
    centres: tuple[Vector, ...]
    sizes: tuple[Vector, ...]
    reach: float
    kind: int = _BOX
    body: int = 0


Shape = Geom | Choice


def merged(pairs: Sequence[Pair], geoms: Sequence[Geom]) -> list[tuple[Pair, Shape]]:
    """The pairs, each with its second geom; pairs of one geom with fixed boxes as few choices."""
    groups: dict[object, list[Pair]] = {}
    for pair in pairs:
        other = geoms[pair.other]
        is_fixed_box = other.kind == _BOX and not other.body
        alike = (pair.one, pair.parameters, str(other.rotation)) if is_fixed_box else pair
        groups.setdefault(alike, []).append(pair)
    found = list[tuple[Pair, Shape]]()
    for group in groups.values():
        for part in _apart(group, geoms) if len(group) > 1 else [group]:
            found.append((part[0], _choice(part, geoms) if len(part) > 1 else geoms[part[0].other]))
    return found


def chosen(choice: Choice, centre: Vector) -> Placed:
    """The box that a geom with this centre [3] is near; any of them, where it is near none."""
    here = rotate(transpose(choice.rotation), centre)
    boxes = list(zip(choice.centres, choice.sizes, strict=True))
    varying = [k for k in range(3) if len({(middle[k], size[k]) for middle, size in boxes}) > 1]
    position, size = list(choice.centres[0]), list(choice.sizes[0])
    for middle, its_size in boxes[1:]:
        # Boxes that are apart differ in one direction at least.
        is_near = absolute(here[varying[0]] - middle[varying[0]]) < its_size[varying[0]] + choice.reach
        for k in varying[1:]:
            is_near = is_near & (absolute(here[k] - middle[k]) < its_size[k] + choice.reach)
        for k in varying:
            position[k] = select(is_near, middle[k], position[k])
            size[k] = select(is_near, its_size[k], size[k])
    return Placed(rotate(choice.rotation, position), _TURNED, choice.rotation, size)


def _choice(pairs: Sequence[Pair], geoms: Sequence[Geom]) -> Choice:
    boxes = [geoms[pair.other] for pair in pairs]
    rotation = boxes[0].rotation
    centres = tuple(rotate(transpose(rotation), box.position) for box in boxes)
    return Choice(rotation, centres, tuple(box.size for box in boxes), _reach(pairs[0], geoms))


def _apart(pairs: Sequence[Pair], geoms: Sequence[Geom]) -> list[list[Pair]]:
    """The pairs in a few lists; in a list, the geom is never near two of the boxes."""
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
