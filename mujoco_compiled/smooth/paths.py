"""What forces act along: lengths that change with the state.

Source: MuJoCo's documentation, Computation, "Actuation model", "Transmission".
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import mujoco

from mujoco_compiled.program.arithmetic import Number, Vector, add, cross, dot, subtract, total
from mujoco_compiled.smooth.dynamics import Motion
from mujoco_compiled.smooth.kinematics import Poses
from mujoco_compiled.smooth.tree import Tree, moved_by

# By the address of a position or of a velocity.
Coefficients = dict[int, Number]


@dataclass(frozen=True)
class Stretch:
    """A length in m or rad, and how it changes with each degree of freedom: MuJoCo's `ten_length` and a row
    of `ten_J`."""

    length: Number
    moment: Coefficients

    def rate(self, qvel: Vector) -> Number:
        """The length's, in m/s or rad/s."""
        return weighted(self.moment, qvel)


# Along what a force acts, and how it changes with the rate.
Slope = tuple[Stretch, Number]


@dataclass(frozen=True)
class Linear:
    """A sum of positions, each times a coefficient.

    of_positions: by address in qpos; empty where there is no length. moment: the same by degree of freedom.
    """

    of_positions: Coefficients
    moment: Coefficients

    @property
    def dofs(self) -> Collection[int]:
        """The degrees of freedom that change the length."""
        return self.moment


@dataclass(frozen=True)
class OfTendon:
    """The length of a spatial tendon, times `gear`. dofs: see `Linear`."""

    tendon: int
    gear: Number
    dofs: tuple[int, ...]


Path = Linear | OfTendon


def stretch(path: Path, qpos: Vector, tendons: Sequence[Stretch]) -> Stretch:
    """The path's length in a state. qpos: [nq]. tendons: the stretches of the model's tendons."""
    if isinstance(path, Linear):
        return Stretch(weighted(path.of_positions, qpos), path.moment)
    of_tendon = tendons[path.tendon]
    moment = {dof: path.gear * coefficient for dof, coefficient in of_tendon.moment.items()}
    return Stretch(path.gear * of_tendon.length, moment)


@dataclass(frozen=True)
class Posture:
    """A state's positions. qpos: [nq]. tendons: the stretches of the model's tendons."""

    tree: Tree
    at: Poses
    moving: Motion
    qpos: Vector
    tendons: Sequence[Stretch] = ()


def wrench(posture: Posture, body: int, place: Vector, force: Vector, torque: Vector) -> Vector:
    """The spatial force [6] on a body of a force at a place in the world and a torque, all [3]."""
    arm = subtract(place, posture.moving.centres[posture.tree.bodies[body].root]) if body else place
    return [*add(torque, cross(arm, force)), *force]


def lever_arms(
    pulled: Mapping[int, Sequence[int]], posture: Posture, wrenches: Sequence[tuple[int, Vector]]
) -> Coefficients:
    """By degree of freedom: the work of spatial forces [6] on bodies in a motion of 1.

    pulled: see `moved_alone`.
    """
    bodies = {body for moved in pulled.values() for body in moved}
    whole = {body: _sum([one for other, one in wrenches if other == body]) for body in bodies}
    return {
        dof: dot(posture.moving.axes[dof], _sum([whole[body] for body in moved]))
        for dof, moved in pulled.items()
    }


def moved_alone(model: mujoco.MjModel, bodies: Iterable[int]) -> dict[int, tuple[int, ...]]:
    """By degree of freedom: those of the bodies that it moves. One that moves all of them is left out: it
    changes nothing between them."""
    different, found = sorted(set(bodies)), dict[int, list[int]]()
    for body in different:
        for dof in moved_by(model, body):
            found.setdefault(dof, []).append(body)
    return {dof: tuple(moved) for dof, moved in sorted(found.items()) if len(moved) < len(different)}


def _sum(vectors: Sequence[Vector]) -> Vector:
    return [total(entries) for entries in zip(*vectors, strict=True)]


def weighted(coefficients: Coefficients, values: Vector) -> Number:
    """The values at the coefficients' addresses, each times its coefficient: a length or its rate."""
    return total(coefficient * values[place] for place, coefficient in coefficients.items())
