"""The terms of an observation: which numbers each yields, by name and unit, and where they are."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, ClassVar, Literal

from pydantic import Field

from core.environments.info import Slice, named
from core.environments.terms import array_slices
from core.environments.terms.array_slices import CINERT, CVEL, MATRIX_AND_MASS
from core.environments.terms.inventory import Inventory, ModelParts, Sensor
from core.environments.terms.sensed import Sensed, as_measured
from core.environments.terms.term import DELAY, Array, Delay, Names, OfBodies, OfBody, Term
from core.patterns import PATTERNS, Patterns

if TYPE_CHECKING:
    from core.environments.terms.step import ModelIndex, Step

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
_MATRIX = tuple(f"{row}{column}" for row in _AXES for column in _AXES)


class ObservationTerm(Term):
    """Numbers that a policy sees: those of `measure` with noise and bias, times `scale`, within ± `clip`; of
    these, the last ones up to the delay. A critic sees them without noise, bias and delay.

    The parts that it names are in the model.
    """

    scale: float = Field(default=1.0, gt=0, le=1e6, description="What is seen is the number times this.")
    noise: float = Field(
        default=0.0, ge=0, le=1e6, description="Uniform in ± this, drawn in each step, before the scale."
    )
    bias: float = Field(
        default=0.0, ge=0, le=1e6, description="Uniform in ± this, drawn for each episode, before the scale."
    )
    delay: Delay | None = Field(default=None, description=f"How old what is seen is. {DELAY}")
    history: int = Field(
        default=1,
        ge=1,
        le=100,
        description="How many of the last values are seen, the oldest first; an episode's first value stands "
        "for those before it.",
    )
    clip: float | None = Field(default=None, gt=0, le=1e6, description="Bounds what is seen to ± this.")

    def size(self, parts: ModelParts) -> int:
        """How many numbers it has at most, counted without naming each."""
        raise NotImplementedError

    def slices(self, parts: ModelParts) -> Iterable[Slice]:
        """Its numbers by name and unit."""
        raise NotImplementedError

    def slices_of_history(self, parts: ModelParts) -> Iterable[Slice]:
        """Those of all steps that are seen, the oldest first; `knee t-2` is two steps older than `knee`."""
        for age in reversed(range(self.history)):
            of_the_past = f" t-{age}" if age else ""
            for part in self.slices(parts):
                components = tuple(f"{name}{of_the_past}" for name in part.components)
                low, high = self._bounds(part)
                yield replace(part, low=low, high=high, components=components)

    def _bounds(self, part: Slice) -> tuple[float | None, float | None]:
        """Those of what is seen of these numbers."""
        low, high = (None if end is None else self.scale * end for end in (part.low, part.high))
        if self.clip is not None:
            low = -self.clip if low is None else max(low, -self.clip)
            high = self.clip if high is None else min(high, self.clip)
        return low, high

    def sensed(self, model: "ModelIndex", parts: ModelParts) -> Sensed:
        """What a robot measures for it, before noise, scale and clip."""
        return as_measured(self.label, self.slices(parts))

    def seen(
        self, step: "Step", model: "ModelIndex", uniform: Array | None = None, bias: Array | None = None
    ) -> Array:
        """Its numbers in a step as they are seen, [n]: now, or by `remembered` later.

        uniform: [n] random numbers in [0, 1) for the noise; None: none. bias: [n]; None: none.
        """
        values = self.measure(step, model)
        if bias is not None and self.bias:
            values = values + bias
        if uniform is not None and self.noise:
            values = values + self.noise * (2.0 * uniform - 1.0)
        if self.scale != 1.0:
            values = self.scale * values
        return values if self.clip is None else step.xp.clip(values, -self.clip, self.clip)


class _BodyNumbers(OfBodies, ObservationTerm):
    """Rows of an array that has one for each body. title: of its slice; None: its kind."""

    array: ClassVar[str]
    parts: ClassVar[Sequence[str]]
    unit: ClassVar[str]
    title: ClassVar[str | None] = None

    def size(self, parts: ModelParts) -> int:
        number = parts.model.sizes.nbody if self.bodies is None else len(self.bodies)
        return number * len(self.parts)

    def slices(self, parts: ModelParts) -> Iterable[Slice]:
        number, name = parts.model.sizes.nbody - 1, self.title or self.label
        all_named = [body for body in parts.model.bodies if body != "world"]
        if self.bodies is None and len(all_named) != number:  # One has no name.
            yield Slice(name, 0, number * len(self.parts), self.unit)
        else:
            yield array_slices.rows(name, self.bodies or all_named, self.parts, self.unit)

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return step.after.derived[self.array][step.places(model.bodies(self.bodies))].ravel()


class Qpos(ObservationTerm):
    """Positions of all joints, in MuJoCo's order: m, rad, quaternions w x y z."""

    kind: Literal["qpos"] = "qpos"
    root_position: Literal["all", "height", "none"] | None = Field(
        default=None,
        description="Which of x, y and z of the root's free joint to include; null: the height. A model "
        "without a free joint keeps all positions.",
    )
    without: Patterns | None = Field(
        default=None, description=f"Hinges and slides to leave out; null: none. {PATTERNS}"
    )

    def size(self, parts: ModelParts) -> int:
        return parts.model.sizes.nq

    def slices(self, parts: ModelParts) -> Iterable[Slice]:
        return array_slices.qpos(parts.model, self._hidden(parts))

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return step.after.qpos[step.places(model.visible_positions(self._num_hidden, self.without))]

    @property
    def _num_hidden(self) -> int:
        """How many of the root's x, y and z are left out."""
        return {"all": 0, "none": 3}.get(self.root_position or "", 2)

    def _hidden(self, parts: ModelParts) -> list[int]:
        free = [joint for joint in parts.model.joints if joint.type == "free" and joint.body == parts.root]
        others = parts.model.moving_joints(self.without) if self.without else []
        return [
            *(free[0].qpos_start + place for place in range(self._num_hidden) if free),
            *(joint.qpos_start for joint in others),
        ]


class Qvel(ObservationTerm):
    """Velocities of all joints, in MuJoCo's order: m/s, rad/s."""

    kind: Literal["qvel"] = "qvel"

    def size(self, parts: ModelParts) -> int:
        return parts.model.sizes.nv

    def slices(self, parts: ModelParts) -> Iterable[Slice]:
        return array_slices.qvel(parts.model)

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return step.after.qvel


class Height(OfBody, ObservationTerm):
    """How high a body is above the world's origin, in m."""

    kind: Literal["height"] = "height"

    def size(self, parts: ModelParts) -> int:
        return 1

    def slices(self, parts: ModelParts) -> Iterable[Slice]:
        yield named("height", (f"{self.body or parts.root} height",), "m")

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return model.position(step.after, model.body(self.body))[2:]


class PreviousAction(ObservationTerm):
    """The previous action; zeros at the start of an episode."""

    kind: Literal["previous_action"] = "previous_action"

    def size(self, parts: ModelParts) -> int:
        return len(parts.acting)

    def slices(self, parts: ModelParts) -> Iterable[Slice]:
        yield named("previous_action", parts.acting, "1", -1.0, 1.0)

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return step.action


class Activation(ObservationTerm):
    """The states of actuators that have one."""

    kind: Literal["act"] = "act"

    def size(self, parts: ModelParts) -> int:
        return parts.model.sizes.na

    def slices(self, parts: ModelParts) -> Iterable[Slice]:
        yield Slice("act", 0, parts.model.sizes.na)

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return step.after.act


class Sensors(ObservationTerm):
    """The model's sensors; those of forces and accelerations are read at the last physics step."""

    kind: Literal["sensors"] = "sensors"
    names: Names | None = Field(default=None, description="The sensors, in this order; null: all.")

    def size(self, parts: ModelParts) -> int:
        return sum(sensor.size for sensor in self._sensors(parts.model))

    def slices(self, parts: ModelParts) -> Iterable[Slice]:
        for sensor in self._sensors(parts.model):
            name = sensor.name or sensor.type
            names = [name] if sensor.size == 1 else [f"{name} {number}" for number in range(sensor.size)]
            yield named("sensors", names, _UNITS.get(sensor.type))

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return step.after.derived["sensordata"][step.places(model.sensors(self.names))]

    def _sensors(self, model: Inventory) -> Sequence[Sensor]:
        if self.names is None:
            return model.sensors
        by_name = {sensor.name: sensor for sensor in model.sensors}
        return [by_name[name] for name in self.names]


class BodyPositions(_BodyNumbers):
    """Positions of bodies in the world, in metres."""

    array, parts, unit = "xpos", _AXES, "m"

    kind: Literal["body_positions"] = "body_positions"
    relative: bool = Field(default=False, description="Relative to the root, along the world's axes.")

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        positions = super().measure(step, model)
        if not self.relative:
            return positions
        return (positions.reshape(-1, 3) - step.after.derived[self.array][model.root]).ravel()


class BodyOrientations(_BodyNumbers):
    """Rotation matrices of bodies, row by row."""

    array, parts, unit = "xmat", _MATRIX, "1"

    kind: Literal["body_orientations"] = "body_orientations"


class Cvel(_BodyNumbers):
    """Velocities of bodies: angular in rad/s, then linear in m/s at the centre of mass of their tree."""

    array, parts, unit = "cvel", CVEL, "rad/s, m/s"

    kind: Literal["cvel"] = "cvel"


class Cinert(_BodyNumbers):
    """Inertias of bodies about the centre of mass of their tree, in kg m², kg m and kg."""

    array, parts, unit = "cinert", CINERT, "kg m², kg m, kg"

    kind: Literal["cinert"] = "cinert"


class BodyInertias(_BodyNumbers):
    """`cinert` as matrices: of each body the inertia row by row, then its mass. As in Brax's humanoid."""

    array, parts, unit, title = "cinert", MATRIX_AND_MASS, "kg m², kg", "inertia"

    kind: Literal["body_inertias"] = "body_inertias"

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        columns = step.xp.asarray([CINERT.index(part) for part in self.parts])
        return step.after.derived[self.array][step.places(model.bodies(self.bodies))][:, columns].ravel()


class ShareVelocities(_BodyNumbers):
    """Velocities of bodies: that of its own centre of mass times the body's share of all masses, in m/s, then
    the angular velocity, in rad/s. As in Brax's humanoid."""

    array, parts, unit, title = "cvel", (*CVEL[3:], *CVEL[:3]), "m/s, rad/s", "velocity"

    kind: Literal["share_velocities"] = "share_velocities"

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        physics, own = step.after, slice(1, None)
        # cinert holds the mass times the offset from the tree's centre of mass, at which cvel is taken.
        moment = physics.derived["cinert"][own, 6:9]
        masses = physics.model.get("body_mass", step.array(model.model.body_mass))[own, None]
        angular, linear = physics.derived["cvel"][own, :3], physics.derived["cvel"][own, 3:]
        linear = linear + step.xp.cross(angular, moment / masses)
        seen = step.xp.concatenate([linear * (masses / masses.sum()), angular], axis=1)
        return (seen if self.bodies is None else seen[model.bodies(self.bodies) - 1]).ravel()


class ActuatorForces(ObservationTerm):
    """The actuators' forces on each degree of freedom in the last physics step, in N or N m."""

    kind: Literal["qfrc_actuator"] = "qfrc_actuator"

    def size(self, parts: ModelParts) -> int:
        return parts.model.sizes.nv

    def slices(self, parts: ModelParts) -> Iterable[Slice]:
        return array_slices.qfrc_actuator(parts.model)

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return step.after.derived["qfrc_actuator"]


NumbersOfMujoco = (
    Qpos
    | Qvel
    | Height
    | PreviousAction
    | Activation
    | Sensors
    | BodyPositions
    | BodyOrientations
    | Cvel
    | Cinert
    | BodyInertias
    | ShareVelocities
    | ActuatorForces
)
