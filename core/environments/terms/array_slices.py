"""MuJoCo's own arrays as slices: a name and a unit for each number."""

from collections.abc import Collection, Sequence
from itertools import groupby

from core.environments.info import Slice, named
from core.environments.terms.inventory import Inventory, JointType

_AXES = ("x", "y", "z")
_QUATERNION = ("qw", "qx", "qy", "qz")
# MuJoCo's order of an inertia about the centre of mass of the tree, its first moment, and the mass.
CINERT = ("Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz", "mx", "my", "mz", "m")
# A symmetric matrix row by row, and the mass.
MATRIX_AND_MASS = ("Ixx", "Ixy", "Ixz", "Ixy", "Iyy", "Iyz", "Ixz", "Iyz", "Izz", "m")
CVEL = ("wx", "wy", "wz", "vx", "vy", "vz")

# A number's name and its unit.
_Number = tuple[str, str]


def qpos(model: Inventory, hidden: Collection[int] = ()) -> list[Slice]:
    """Positions; rotations of free and ball joints are quaternions. hidden: places in qpos to leave out."""
    numbers = [number for name, kind in _joints(model) for number in _position(name, kind)]
    return _by_unit("qpos", [number for place, number in enumerate(numbers) if place not in hidden])


def qvel(model: Inventory) -> list[Slice]:
    """Velocities: of a free joint along the world's axes and about the body's."""
    return _by_unit("qvel", _degrees_of_freedom(model, "m/s", "rad/s", ("v", "w")))


def qfrc_actuator(model: Inventory) -> list[Slice]:
    """The actuators' forces on each degree of freedom."""
    return _by_unit("qfrc_actuator", _degrees_of_freedom(model, "N", "N m", ("f", "t")))


def rows(name: str, bodies: Sequence[str], parts: Sequence[str], unit: str) -> Slice:
    """The same quantities of each body; unit: those of a row, in order."""
    return named(name, (f"{body} {part}" for body in bodies for part in parts), unit)


def ctrl(model: Inventory) -> list[Slice]:
    """An action that is the control of each actuator."""
    acting = zip(model.acting, model.actuators, strict=True)
    return [named(name, (name,), "1", *(actuator.control_range or (-1.0, 1.0))) for name, actuator in acting]


def _joints(model: Inventory) -> list[tuple[str, JointType]]:
    """The joints' names, made of the bodies' where they have none, and their types."""
    return [
        (joint.name or f"{joint.body} joint {number}", joint.type)
        for number, joint in enumerate(model.joints)
    ]


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


def _degrees_of_freedom(model: Inventory, along: str, about: str, letters: tuple[str, str]) -> list[_Number]:
    """Those of all joints; along, about: the units. letters: before the axes of free and ball joints."""
    linear, angular = letters
    numbers: list[_Number] = []
    for joint, kind in _joints(model):
        turns = [(f"{joint} {angular}{axis}", about) for axis in _AXES]
        match kind:
            case "free":
                numbers += [*((f"{joint} {linear}{axis}", along) for axis in _AXES), *turns]
            case "ball":
                numbers += turns
            case "slide":
                numbers.append((joint, along))
            case "hinge":
                numbers.append((joint, about))
    return numbers


def _by_unit(name: str, numbers: Sequence[_Number]) -> list[Slice]:
    return [
        named(name, (number for number, _ in group), unit)
        for unit, group in groupby(numbers, key=lambda number: number[1])
    ]
