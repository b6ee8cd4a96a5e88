"""The parts of our environments' bodies that name their numbers, from a table made of the models.

`python -m core.environments.describe_bodies` makes the table.
"""

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import groupby
from pathlib import Path
from typing import Any, Literal

from core.environments.info import Slice, named

TABLE = Path(__file__).parent / "bodies.json"
JointType = Literal["free", "ball", "slide", "hinge"]


@dataclass(frozen=True)
class Body:
    """joints: by name, in MuJoCo's order. controls: of each actuator, by its name or that of its joint, the
    control's range. bodies: all but the world; () if not all of them have names."""

    joints: Mapping[str, JointType]
    controls: Mapping[str, tuple[float, float]]
    bodies: tuple[str, ...] = ()


@cache
def body(name: str) -> Body:
    """The body of this environment; of the corridor that of a walker, `corridor/<walker>`."""
    row = _table()[name]
    controls = {actuator: (low, high) for actuator, (low, high) in row["controls"].items()}
    return Body(row["joints"], controls, tuple(row["bodies"]))


@cache
def _table() -> dict[str, Any]:
    return json.loads(TABLE.read_text())


_AXES = ("x", "y", "z")
_QUATERNION = ("qw", "qx", "qy", "qz")
# MuJoCo's order of an inertia about the centre of mass of the tree, its first moment, and the mass.
CINERT = ("Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz", "mx", "my", "mz", "m")
# A symmetric matrix row by row, and the mass.
MATRIX_AND_MASS = ("Ixx", "Ixy", "Ixz", "Ixy", "Iyy", "Iyz", "Ixz", "Iyz", "Izz", "m")
CVEL = ("wx", "wy", "wz", "vx", "vy", "vz")

# A number's name and its unit.
_Number = tuple[str, str]


def qpos(body: Body, hidden: Collection[int] = (), names: Mapping[int, str] | None = None) -> list[Slice]:
    """Positions; rotations of free and ball joints are quaternions.

    hidden: the places in qpos that are left out. names: others than those of the joints, by place.
    """
    numbers = [number for joint, kind in body.joints.items() for number in _position(joint, kind)]
    renamed = [((names or {}).get(place, name), unit) for place, (name, unit) in enumerate(numbers)]
    return _by_unit("qpos", [number for place, number in enumerate(renamed) if place not in hidden])


def qvel(body: Body, bound: float | None = None) -> list[Slice]:
    """Velocities: of a free joint along the world's axes and about the body's. bound: of all of them."""
    return _by_unit("qvel", _degrees_of_freedom(body, "m/s", "rad/s", ("v", "w")), bound)


def qfrc_actuator(body: Body) -> list[Slice]:
    """The actuators' forces on each degree of freedom."""
    return _by_unit("qfrc_actuator", _degrees_of_freedom(body, "N", "N m", ("f", "t")))


def rows(name: str, bodies: Sequence[str], parts: Sequence[str], unit: str) -> Slice:
    """The same quantities of each body; unit: those of a row, in order."""
    return named(name, (f"{body} {part}" for body in bodies for part in parts), unit)


def controls(body: Body, unit: str | None = "1") -> list[Slice]:
    """An action of one number for each actuator."""
    return [named(name, (name,), unit, low, high) for name, (low, high) in body.controls.items()]


def _position(joint: str, kind: JointType) -> list[_Number]:
    rotation = [(f"{joint} {part}", "1") for part in _QUATERNION]
    match kind:
        case "free":
            return [*((f"{joint} {axis}", "m") for axis in _AXES), *rotation]
        case "ball":
            return rotation
        case "slide":
            return [(joint, "m")]
        case "hinge":
            return [(joint, "rad")]


def _degrees_of_freedom(body: Body, along: str, about: str, letters: tuple[str, str]) -> list[_Number]:
    """Those of all joints; along, about: the units. letters: before the axes of free and ball joints."""
    return [
        number
        for joint, kind in body.joints.items()
        for number in _freedom(joint, kind, along, about, letters)
    ]


def _freedom(joint: str, kind: JointType, along: str, about: str, letters: tuple[str, str]) -> list[_Number]:
    linear, angular = letters
    turns = [(f"{joint} {angular}{axis}", about) for axis in _AXES]
    match kind:
        case "free":
            return [*((f"{joint} {linear}{axis}", along) for axis in _AXES), *turns]
        case "ball":
            return turns
        case "slide":
            return [(joint, along)]
        case "hinge":
            return [(joint, about)]


def _by_unit(name: str, numbers: Sequence[_Number], bound: float | None = None) -> list[Slice]:
    low = None if bound is None else -bound
    return [
        named(name, (number for number, _ in group), unit, low, bound)
        for unit, group in groupby(numbers, key=lambda number: number[1])
    ]
