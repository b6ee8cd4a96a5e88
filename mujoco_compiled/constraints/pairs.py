"""Which geoms of a model can touch: MuJoCo's own filter, which no state changes; and how such contacts push.

Source: MuJoCo's documentation, Computation, "Collision detection", "Selection", "Parameters".
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import reduce

import mujoco
import numpy as np

from mujoco_compiled.constraints.solref import SpringDamper, read_spring
from mujoco_compiled.fields import Fields
from mujoco_compiled.program.arithmetic import Number, Vector, maximum, minimum, select


@dataclass(frozen=True)
class ContactParameters:
    """Those of a contact.

    friction: one for each direction but the normal: tangents, turning about the normal, rolling; empty
    without friction. margin: the distance in m below which it pushes. reach: in m; farther geoms are not
    looked at. friction_damping: of an elliptic cone's directions but the normal.
    """

    friction: tuple[Number, ...]
    spring: SpringDamper
    margin: float
    reach: float
    friction_damping: Number


@dataclass(frozen=True)
class Pair:
    """Numbers of two geoms in MuJoCo's order: the contact's normal is from the first to the second."""

    one: int
    other: int
    parameters: ContactParameters


def read_pairs(fields: Fields) -> list[Pair]:
    """The geoms that can touch: pairs that the model lists, and those that its filter lets pass, but for
    `meshes_left_out`."""
    model = fields.model
    listed, left_out = listed_geoms(model), set(meshes_left_out(model))
    found = [_pair(model, one, other, _of_pair(fields, place)) for place, (one, other) in enumerate(listed)]
    return found + [
        _pair(model, one, other, _of_geoms(fields, one, other))
        for one, other in touching_geoms(model)
        if (one, other) not in left_out
    ]


def meshes_left_out(model: mujoco.MjModel) -> list[tuple[int, int]]:
    """Numbers of two meshes that may touch in MuJoCo, and do not here: the parts of a robot's shell. Those
    that the model lists as pairs are not among them."""
    is_mesh = model.geom_type == mujoco.mjtGeom.mjGEOM_MESH
    if np.count_nonzero(is_mesh) < 2:
        return []
    return [(one, other) for one, other in touching_geoms(model) if is_mesh[one] and is_mesh[other]]


def pairs_of_geoms(model: mujoco.MjModel) -> Iterator[tuple[int, int]]:
    """Numbers of geoms that may touch: pairs that the model lists, and those that its filter lets pass."""
    yield from listed_geoms(model)
    yield from touching_geoms(model)


def listed_geoms(model: mujoco.MjModel) -> list[tuple[int, int]]:
    """The geoms of each `<pair>`."""
    return [(int(a), int(b)) for a, b in zip(model.pair_geom1, model.pair_geom2, strict=True)]


def touching_geoms(model: mujoco.MjModel) -> Iterator[tuple[int, int]]:
    """Pairs of geoms, the lower number first, without those that the model lists as pairs."""
    listed = {frozenset(pair) for pair in listed_geoms(model)}
    bodies, types, affinities = model.geom_bodyid, model.geom_contype, model.geom_conaffinity
    welds = model.body_weldid[bodies]
    for one in range(model.ngeom):
        later = slice(one + 1, None)
        asks = (types[one] & affinities[later]) | (types[later] & affinities[one])
        # The world of a user's model may have thousands of geoms: those pairs are not looked at one by one.
        for other in np.flatnonzero((asks != 0) & (welds[later] != welds[one])) + one + 1:
            is_listed = frozenset((one, int(other))) in listed
            if not is_listed and _bodies_may(model, int(bodies[one]), int(bodies[other])):
                yield one, int(other)


def solref_and_solimp(fields: Fields, one: int, other: int) -> tuple[Vector, np.ndarray]:
    """solref [2] and solimp [5] of two geoms: those of the one with the higher priority, or between both."""
    model = fields.model
    priorities = model.geom_priority[[one, other]]
    if priorities[0] != priorities[1]:
        first = (one, other)[int(priorities.argmax())]
        return fields.row("geom_solref", first), model.geom_solimp[first]
    share = _share(float(model.geom_solmix[one]), float(model.geom_solmix[other]))
    solimp = share * model.geom_solimp[one] + (1.0 - share) * model.geom_solimp[other]
    return _mixed(share, fields.row("geom_solref", one), fields.row("geom_solref", other)), solimp


def _mixed(share: float, one: Vector, other: Vector) -> Vector:
    """Between two `solref`, if both are time constants; otherwise the lesser numbers."""
    return [
        select(one[0] > 0.0, select(other[0] > 0.0, share * x + (1.0 - share) * y, least), least)
        for x, y in zip(one, other, strict=True)
        for least in [minimum(x, y)]
    ]


def _bodies_may(model: mujoco.MjModel, one: int, other: int) -> bool:
    """Not two parts of one rigid body, not a body and its parent, and not bodies that the model excludes."""
    welds = int(model.body_weldid[one]), int(model.body_weldid[other])
    if welds[0] == welds[1]:
        return False
    above = [int(model.body_weldid[model.body_parentid[weld]]) for weld in welds]
    filters = not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_FILTERPARENT
    if filters and 0 not in welds and (above[0] == welds[1] or above[1] == welds[0]):
        return False
    signature = (min(one, other) << 16) + max(one, other)
    return signature not in model.exclude_signature


def _pair(model: mujoco.MjModel, one: int, other: int, parameters: ContactParameters) -> Pair:
    first, second = (one, other) if model.geom_type[one] <= model.geom_type[other] else (other, one)
    return Pair(first, second, parameters)


def _of_geoms(fields: Fields, one: int, other: int) -> ContactParameters:
    model, both = fields.model, [one, other]
    priorities = model.geom_priority[both]
    chosen = [both[int(priorities.argmax())]] if priorities[0] != priorities[1] else both
    frictions = [fields.row("geom_friction", geom) for geom in chosen]
    sliding, turning, rolling = (reduce(maximum, several) for several in zip(*frictions, strict=True))
    friction = (sliding, sliding, turning, rolling, rolling)
    spring = read_spring(*solref_and_solimp(fields, one, other), model.opt.timestep)
    margin, gap = float(model.geom_margin[both].sum()), float(model.geom_gap[both].sum())
    dimensions = int(model.geom_condim[chosen].max())
    return ContactParameters(_bounded(friction, dimensions), spring, margin, margin + gap, spring.damping)


def _of_pair(fields: Fields, place: int) -> ContactParameters:
    model = fields.model
    solimp, own = model.pair_solimp[place], fields.row("pair_solreffriction", place)
    spring = read_spring(fields.row("pair_solref", place), solimp, model.opt.timestep)
    damping = spring.damping
    if all(own) and (own[0] > 0.0) == (own[1] > 0.0):
        damping = read_spring(own, solimp, model.opt.timestep).damping
    margin, gap = float(model.pair_margin[place]), float(model.pair_gap[place])
    friction = tuple(fields.row("pair_friction", place))
    return ContactParameters(
        _bounded(friction, int(model.pair_dim[place])), spring, margin, margin + gap, damping
    )


def _bounded(friction: tuple[Number, ...], dimensions: int) -> tuple[Number, ...]:
    return tuple(maximum(x, mujoco.mjMINMU) for x in friction[: dimensions - 1])


def _share(one: float, other: float) -> float:
    """The first geom's part in a mixture."""
    smallest = float(mujoco.mjMINVAL)
    if one < smallest or other < smallest:
        return 0.5 if max(one, other) < smallest else float(one >= smallest)
    return one / (one + other)
