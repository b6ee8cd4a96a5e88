"""The observation terms of a job; `mjcf.observations` finds them in the state."""

from typing import Annotated, Literal

from pydantic import Field

from core.documents import Strict
from core.environments.mjcf.vocabulary.parts import Names, OfBodies


class Qpos(Strict):
    """Positions of all joints, in MuJoCo's order: m, rad, quaternions w x y z."""

    kind: Literal["qpos"] = "qpos"
    root_position: Literal["all", "height", "none"] | None = Field(
        default=None,
        description="Which of x, y and z of the root's free joint to include; null: the height. A model "
        "without a free joint keeps all positions.",
    )


class Qvel(Strict):
    """Velocities of all joints, in MuJoCo's order: m/s, rad/s."""

    kind: Literal["qvel"] = "qvel"


class PreviousAction(Strict):
    """The previous action; zeros at the start of an episode."""

    kind: Literal["previous_action"] = "previous_action"


class Activation(Strict):
    """The states of actuators that have one."""

    kind: Literal["act"] = "act"


class Sensors(Strict):
    """The model's sensors; those of forces and accelerations are read at the last physics step."""

    kind: Literal["sensors"] = "sensors"
    names: Names | None = Field(default=None, description="The sensors, in this order; null: all.")


class BodyPositions(OfBodies):
    """Positions of bodies in the world, in metres."""

    kind: Literal["body_positions"] = "body_positions"
    relative: bool = Field(default=False, description="Relative to the root, along the world's axes.")


class BodyOrientations(OfBodies):
    """Rotation matrices of bodies, row by row."""

    kind: Literal["body_orientations"] = "body_orientations"


class Cvel(OfBodies):
    """Velocities of bodies: angular in rad/s, then linear in m/s at the centre of mass of their tree."""

    kind: Literal["cvel"] = "cvel"


class Cinert(OfBodies):
    """Inertias of bodies about the centre of mass of their tree, in kg m², kg m and kg."""

    kind: Literal["cinert"] = "cinert"


class ActuatorForces(Strict):
    """The actuators' forces on each degree of freedom in the last physics step, in N or N m."""

    kind: Literal["qfrc_actuator"] = "qfrc_actuator"


ObservationTerm = Annotated[
    Qpos
    | Qvel
    | PreviousAction
    | Activation
    | Sensors
    | BodyPositions
    | BodyOrientations
    | Cvel
    | Cinert
    | ActuatorForces,
    Field(discriminator="kind"),
]
