"""The numbers of an observation and an action of a user's own model, as far as its parts are known."""

from collections.abc import Iterable, Sequence

from core.environments.bodies import CINERT, CVEL, Body, JointType, qfrc_actuator, qpos, qvel, rows
from core.environments.info import Slice, Spaces, in_order, named
from core.environments.mjcf.info import MjcfOptions
from core.environments.mjcf.inventory import Inventory, Sensor
from core.environments.mjcf.vocabulary import (
    Activation,
    ActuatorForces,
    BodyOrientations,
    BodyPositions,
    Cinert,
    Cvel,
    ObservationTerm,
    PreviousAction,
    Qpos,
    Qvel,
    Sensors,
)

# By MuJoCo's type of a sensor; where the unit depends on the part that it reads, it is not known here.
_UNITS = {
    "touch": "N",
    "accelerometer": "m/s²",
    "velocimeter": "m/s",
    "gyro": "rad/s",
    "force": "N",
    "torque": "N m",
    "rangefinder": "m",
    "ballquat": "1",
    "ballangvel": "rad/s",
    "framepos": "m",
    "framequat": "1",
    "framexaxis": "1",
    "frameyaxis": "1",
    "framezaxis": "1",
    "framelinvel": "m/s",
    "frameangvel": "rad/s",
    "framelinacc": "m/s²",
    "frameangacc": "rad/s²",
    "subtreecom": "m",
    "subtreelinvel": "m/s",
    "subtreeangmom": "kg m²/s",
    "clock": "s",
}
_AXES = ("x", "y", "z")
_NUMBERS_OF_A_BODY = {"body_positions": 3, "body_orientations": 9, "cvel": 6, "cinert": 10}
_MATRIX = tuple(f"{row}{column}" for row in _AXES for column in _AXES)


def mjcf_slices(options: MjcfOptions, model: Inventory) -> Spaces:
    """model: the parts of the model that the options name."""
    terms = options.observation or [Qpos(), Qvel()]
    seen = [one for term in terms for one in _term(term, options, model)]
    acts = [_control(name, model.actuators[place].control_range) for place, name in enumerate(_acting(model))]
    return Spaces(in_order(seen), in_order(acts))


def num_observed(options: MjcfOptions, model: Inventory) -> int:
    """How many numbers the observation has at most, counted without naming each."""
    return sum(_num_of(term, model) for term in options.observation or [Qpos(), Qvel()])


def _num_of(term: ObservationTerm, model: Inventory) -> int:
    sizes = model.sizes
    match term:
        case Qpos():
            return sizes.nq
        case Qvel() | ActuatorForces():
            return sizes.nv
        case PreviousAction():
            return sizes.nu
        case Activation():
            return sizes.na
        case Sensors(names=names):
            return sum(sensor.size for sensor in _sensors(names, model))
        case BodyPositions() | BodyOrientations() | Cvel() | Cinert():
            number = sizes.nbody if term.bodies is None else len(term.bodies)
            return number * _NUMBERS_OF_A_BODY[term.kind]


def _term(term: ObservationTerm, options: MjcfOptions, model: Inventory) -> Iterable[Slice]:  # noqa: C901 # A table.
    match term:
        case Qpos():
            return qpos(_body(model), _hidden(term, options.root or model.root, model))
        case Qvel():
            return qvel(_body(model))
        case PreviousAction():
            return [named("previous_action", _acting(model), "1", -1.0, 1.0)]
        case Activation():
            return [Slice("act", 0, model.sizes.na)]
        case Sensors(names=names):
            return map(_sensor, _sensors(names, model))
        case BodyPositions(bodies=names):
            return [_rows("body_positions", names, model, _AXES, "m")]
        case BodyOrientations(bodies=names):
            return [_rows("body_orientations", names, model, _MATRIX, "1")]
        case Cvel(bodies=names):
            return [_rows("cvel", names, model, CVEL, "rad/s, m/s")]
        case Cinert(bodies=names):
            return [_rows("cinert", names, model, CINERT, "kg m², kg m, kg")]
        case ActuatorForces():
            return qfrc_actuator(_body(model))


def _body(model: Inventory) -> Body:
    joints: dict[str, JointType] = {
        joint.name or f"{joint.body} joint {number}": joint.type for number, joint in enumerate(model.joints)
    }
    return Body(joints, {})


def _acting(model: Inventory) -> list[str]:
    """The actuators' names; by number where they have none."""
    return [actuator.name or f"actuator {number}" for number, actuator in enumerate(model.actuators)]


def _control(name: str, bounds: tuple[float, float] | None) -> Slice:
    """Without a range, an action is the control itself."""
    low, high = bounds or (-1.0, 1.0)
    return named(name, (name,), None, low, high)


def _hidden(term: Qpos, root: str, model: Inventory) -> range:
    """As `observations.visible_positions` has it: the places of the root's position that are left out."""
    free = [joint for joint in model.joints if joint.type == "free" and joint.body == root]
    if not free or term.root_position == "all":
        return range(0)
    start = free[0].qpos_start
    return range(start, start + (3 if term.root_position == "none" else 2))


def _sensors(names: list[str] | None, model: Inventory) -> list[Sensor]:
    if names is None:
        return model.sensors
    by_name = {sensor.name: sensor for sensor in model.sensors}
    return [by_name[name] for name in names]


def _sensor(sensor: Sensor) -> Slice:
    name = sensor.name or sensor.type
    components = [name] if sensor.size == 1 else [f"{name} {number}" for number in range(sensor.size)]
    return named("sensors", components, _UNITS.get(sensor.type))


def _rows(name: str, bodies: list[str] | None, model: Inventory, parts: Sequence[str], unit: str) -> Slice:
    """The slice of these bodies, or of all but the world; without components if one has no name."""
    number = model.sizes.nbody - 1
    all_named = [body for body in model.bodies if body != "world"]
    if bodies is None and len(all_named) != number:
        return Slice(name, 0, number * len(parts), unit)
    return rows(name, bodies or all_named, parts, unit)
