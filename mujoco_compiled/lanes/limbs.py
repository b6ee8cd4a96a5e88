"""Limbs that are built alike: those whose work can be shared out to lanes."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property

import mujoco

MOST_LANES = 8
_WIDTHS = {0: (7, 6), 1: (4, 3), 2: (1, 1), 3: (1, 1)}  # positions and velocities of a joint, by its type


@dataclass(frozen=True)
class Limbs:
    """bodies: by lane, the numbers of its limbs' bodies; those at one place are alike."""

    model: mujoco.MjModel
    bodies: tuple[tuple[int, ...], ...]

    @property
    def num_lanes(self) -> int:
        return len(self.bodies)

    @cached_property
    def lane_of_body(self) -> dict[int, int]:
        """Without the trunk's bodies."""
        return {body: lane for lane, own in enumerate(self.bodies) for body in own}

    @cached_property
    def lane_of_dof(self) -> dict[int, int]:
        return {dof: lane for lane, own in enumerate(self._dofs) for dof in own}

    def alike(self, field: str) -> Iterator[tuple[int, ...]]:
        """Places of a field's numbers, flattened, that are alike: by lane. The rest is the trunk's.

        field: qpos, or one whose first axis is by body, degree of freedom, joint, geom or site.
        """
        elements, width = self._elements(field)
        for own in zip(*elements, strict=True):
            for k in range(width):
                yield tuple(width * one + k for one in own)

    @cached_property
    def _joints(self) -> list[list[int]]:
        return [list(_parts(self.model, own, "jnt")) for own in self.bodies]

    @cached_property
    def _dofs(self) -> list[list[int]]:
        return [list(_parts(self.model, own, "dof")) for own in self.bodies]

    def _elements(self, field: str) -> tuple[list[list[int]], int]:
        """By lane: the numbers of its elements; and how many numbers each of them has."""
        model = self.model
        if field == "qpos":
            return [[place for joint in own for place in _positions(model, joint)] for own in self._joints], 1
        if field in ("qvel", "qacc_warmstart"):
            return self._dofs, 1
        kind = field.split("_")[0]
        if kind == "body":
            elements = [list(own) for own in self.bodies]
        else:
            elements = {"dof": self._dofs, "jnt": self._joints}.get(kind) or [
                list(_parts(model, own, kind)) for own in self.bodies
            ]
        values = getattr(model, field)
        return elements, values.size // max(1, len(values))


def find_limbs(model: mujoco.MjModel, num_lanes: int) -> Limbs | None:
    """Limbs for this number of lanes, as near to the root as there are enough that are alike; None: none."""
    lanes: list[list[int]] = [[] for _ in range(num_lanes)]
    _share_out(model, 0, lanes)
    return Limbs(model, tuple(tuple(own) for own in lanes)) if lanes[0] else None


def ways_to_share(model: mujoco.MjModel) -> list[Limbs]:
    """The limbs for each number of lanes for which there are any: first where lanes spare most bodies."""
    found = [find_limbs(model, num_lanes) for num_lanes in range(2, MOST_LANES + 1)]
    return sorted((limbs for limbs in found if limbs is not None), key=_num_spared, reverse=True)


def _num_spared(limbs: Limbs) -> int:
    """Bodies that a lane need not compute."""
    return (limbs.num_lanes - 1) * len(limbs.bodies[0])


def _share_out(model: mujoco.MjModel, body: int, lanes: list[list[int]]) -> None:
    """Give limbs that this body carries to the lanes, as many to each; look further in what is left."""
    alike: dict[object, list[int]] = {}
    for child in _children(model, body):
        alike.setdefault(_kind(model, child), []).append(child)
    for children in alike.values():
        num_shared = len(children) // len(lanes) * len(lanes)
        for place, child in enumerate(children[:num_shared]):
            if _has_joints(model, child):
                lanes[place % len(lanes)] += _subtree(model, child)
        for child in children[num_shared:]:
            _share_out(model, child, lanes)


def _kind(model: mujoco.MjModel, body: int) -> object:
    """Equal for bodies whose subtrees have the same joints in the same places."""
    first, number = int(model.body_jntadr[body]), int(model.body_jntnum[body])
    joints = tuple(int(kind) for kind in model.jnt_type[first : first + number]) if number else ()
    return joints, tuple(_kind(model, child) for child in _children(model, body))


def _has_joints(model: mujoco.MjModel, body: int) -> bool:
    return any(model.body_jntnum[one] for one in _subtree(model, body))


def _subtree(model: mujoco.MjModel, body: int) -> list[int]:
    return [body, *(one for child in _children(model, body) for one in _subtree(model, child))]


def _children(model: mujoco.MjModel, body: int) -> list[int]:
    return [child for child in range(1, model.nbody) if model.body_parentid[child] == body]


def _parts(model: mujoco.MjModel, bodies: Iterable[int], kind: str) -> Iterator[int]:
    """The bodies' joints, degrees of freedom, geoms or sites."""
    owners = getattr(model, f"{kind}_bodyid")
    for body in bodies:
        yield from (number for number, owner in enumerate(owners) if owner == body)


def _positions(model: mujoco.MjModel, joint: int) -> range:
    first = int(model.jnt_qposadr[joint])
    return range(first, first + _WIDTHS[int(model.jnt_type[joint])][0])
