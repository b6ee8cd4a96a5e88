"""A model's parts, by name; the API checks terms against them, so this imports no numerical code."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Literal

from core.documents import Stored
from core.patterns import matching
from core.physics.availability import BodySize, EngineName

# `core.environments.describe_bodies` makes it of the catalog's bodies.
TABLE = Path(__file__).parents[1] / "inventories.json"
# Those of the bodies of plugins.
OF_PLUGINS: dict[str, "Inventory"] = {}
Kind = Literal["body", "geom", "joint", "sensor"]
JointType = Literal["free", "ball", "slide", "hinge"]
# On a joint: the control is a position, a velocity, or a torque or force.
ActuatorKind = Literal["position", "velocity", "motor"]


class Joint(Stored):
    """qpos_start, qvel_start: its first index in qpos and qvel. range: rad or m; None if it has none. effort:
    the greatest torque or force that its actuators may give, N m or N; None: no limit, or it is not known."""

    name: str
    type: JointType
    body: str
    qpos_start: int
    qvel_start: int
    range: tuple[float, float] | None = None
    effort: float | None = None


class Actuator(Stored):
    """control_range: of `ctrl`; None if it has none, and the action is the control itself. joint: the one
    that it moves; None: it moves something else, or the model was described before joints were noted. kind:
    None for another one, or where the model was described before kinds were noted. velocity_limit: the speed
    at which its motor has no torque left, rad/s or m/s; None: it is not known."""

    name: str
    control_range: tuple[float, float] | None = None
    joint: str | None = None
    kind: ActuatorKind | None = None
    velocity_limit: float | None = None


class Sensor(Stored):
    """type: MuJoCo's. size: how many numbers it gives. beyond: engines that cannot read it, and why."""

    name: str
    type: str
    size: int
    beyond: dict[EngineName, str] = {}


class Sizes(Stored):
    """By MuJoCo's names: positions, velocities, controls, activations, and how many of each kind."""

    nq: int
    nv: int
    nu: int
    na: int
    nbody: int
    ngeom: int


class Inventory(Stored):
    """A compiled model's parts. What has no name is left out of bodies and geoms, and has an empty one
    elsewhere; most unnamed bodies, joints and geoms got one when the model was read.

    root: the body that terms mean if they name none (`describe.root_of`). has_free_joint: whether it has one.
    travels: whether it can leave its place. initial_height: the root's in metres, in the initial state.
    num_pairs: pairs of geoms that may touch, up to 10,000; None for models described before it was counted.
    colliders: by name, the moving geoms that can touch something, each with its body and those that this one
    is welded to; None as above. num_fixed_colliders: geoms of the world that can be touched. fixed_geoms: by
    name, all of the world. no_mirror: why clips of the body cannot be mirrored; None: they can, or the model
    was described before this was looked at.
    """

    joints: list[Joint]
    actuators: list[Actuator]
    sensors: list[Sensor]
    bodies: list[str]
    geoms: list[str]
    cameras: list[str]
    keyframes: list[str]
    sizes: Sizes
    root: str
    has_free_joint: bool
    travels: bool
    initial_height: float
    mass_kg: float
    timestep_s: float
    num_pairs: int | None = None
    colliders: dict[str, list[str]] | None = None
    num_fixed_colliders: int = 0
    fixed_geoms: list[str] = []
    has_level_floor: bool | None = None
    no_mirror: str | None = None

    @property
    def body_size(self) -> BodySize | None:
        """None if it is not known."""
        return None if self.num_pairs is None else BodySize(self.sizes.nv, self.num_pairs)

    def moving_joints(self, patterns: Sequence[str] | None = None) -> list[Joint]:
        """The hinges and slides, or those whose whole name one of these regular expressions matches."""
        joints = (joint for joint in self.joints if joint.type in ("hinge", "slide"))
        return [joint for joint in joints if patterns is None or matching(patterns, [joint.name])]

    @property
    def acting(self) -> list[str]:
        """The actuators' names, or those of their joints; by number where they have none."""
        return [
            actuator.name or actuator.joint or f"actuator {number}"
            for number, actuator in enumerate(self.actuators)
        ]

    def names(self, kind: Kind) -> list[str]:
        """The names of a kind of parts; only of joints that have a range."""
        match kind:
            case "body":
                return self.bodies
            case "geom":
                return self.geoms
            case "joint":
                return [joint.name for joint in self.joints if joint.name and joint.range is not None]
            case "sensor":
                return [sensor.name for sensor in self.sensors if sensor.name]


def parts_by_kind(model: Inventory) -> dict[str, tuple[str, ...]]:
    """The names of the parts that a task may name."""
    return {
        "bodies": tuple(model.bodies),
        "joints": tuple(joint.name for joint in model.moving_joints() if joint.name),
        "geoms": tuple(model.geoms),
        "sensors": tuple(model.names("sensor")),
        "keyframes": tuple(filter(None, model.keyframes)),
    }


def names_by_kind(model: Inventory) -> dict[str, tuple[str, ...]]:
    """The names of all parts that a rule of randomization may name."""
    return {
        "actuator": tuple(filter(None, (actuator.name for actuator in model.actuators))),
        "body": tuple(model.bodies),
        "geom": tuple(model.geoms),
        "joint": tuple(filter(None, (joint.name for joint in model.joints))),
    }


@dataclass(frozen=True)
class ModelParts:
    """A model as a task names its parts. root: the body of the terms that name none. acting: the names of an
    action's numbers. feet: the bodies that are, in the order of the gait. command: the name and the unit of
    each number of the task's command. compared: the bodies that are compared with a reference, of which
    frames_ahead are seen."""

    model: Inventory
    root: str
    acting: Sequence[str]
    feet: tuple[str, ...] = ()
    command: tuple[tuple[str, str], ...] = ()
    compared: tuple[str, ...] = ()
    frames_ahead: int = 0

    @property
    def feet_colliders(self) -> dict[str, list[str]]:
        """The geoms that can touch something, of each foot and of what is welded to it."""
        colliders = (self.model.colliders or {}).items()
        return {foot: [geom for geom, on in colliders if foot in on] for foot in self.feet}

    def colliders_of(self, patterns: Sequence[str]) -> list[str]:
        """The geoms that can touch something, of the bodies that a pattern matches."""
        bodies = set(matching(patterns, self.model.bodies[1:]))
        return [geom for geom, on in (self.model.colliders or {}).items() if on[0] in bodies]


@cache
def inventory_of(body: str) -> Inventory:
    """The parts of a body of the catalog; of the corridor those of a walker, `corridor/<walker>`.

    Raises KeyError for a body that the table lacks.
    """
    return OF_PLUGINS.get(body) or Inventory.model_validate(json.loads(TABLE.read_text())[body])
