"""Changes of a model before it is compiled: servos, contacts, shapes, floor, pose; no numerical code."""

from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import Field

from core.bounds import LONGEST_NAME, MOST_MEMBERS, Real
from core.documents import Strict
from core.patterns import PATTERNS, Pattern, Patterns

# The keyframe of a pose.
HOME = "home"
# Of a servo that does not say its gains: kp / effort in 1/rad, and kd / kp in s. Of ten quadrupeds of 12 to
# 127 kg, eight then stand within 0.3 rad of their poses; with half as much two do, and three tip over.
_PER_EFFORT, _DAMPING_S = 2.0, 0.04


def free_name(wanted: str, names: Sequence[str]) -> str:
    """The wanted name, with a number where the names have it already."""
    return next(
        name for name in (wanted, *(f"{wanted} {n + 2}" for n in range(len(names)))) if name not in names
    )


class Servo(Strict):
    """A servo on each of some joints: force = kp · (target - position) - kd · velocity, within ± effort. It
    takes the place of the joint's actuators; the control is the target, without a range.

    The units are those of a hinge; for a slide read N, m and kg.
    """

    joints: Patterns = Field(description=f"Hinges and slides. {PATTERNS}")
    control: Literal["position", "velocity", "effort"] = Field(
        default="position",
        description="What the control is: the target of a position servo; that of a velocity servo, with "
        "force = kd · (target - velocity); or the force itself.",
    )
    kp: float | None = Field(
        default=None,
        gt=0,
        le=1e6,
        description="Stiffness, N m/rad; null: twice the effort per rad, so that half a rad takes all of it.",
    )
    kd: float | None = Field(default=None, ge=0, le=1e5, description="Damping, N m s/rad; null: kp · 0.04 s.")
    effort: float | None = Field(
        default=None,
        gt=0,
        le=1e6,
        description="Greatest torque, N m; null: that of the joint's actuator in the model, if it has one.",
    )
    velocity_limit: float | None = Field(
        default=None,
        gt=0,
        le=1e4,
        description="Speed at which the motor has no torque left, rad/s; it counts where the action has a "
        "`torque_speed_curve`.",
    )
    saturation_effort: float | None = Field(
        default=None,
        gt=0,
        le=1e6,
        description="Torque from which the motor's falls in a line to 0 at its velocity_limit, N m; what is "
        "above the effort is never given. null: the effort.",
    )
    armature: float | None = Field(
        default=None, ge=0, le=1e3, description="Inertia of the rotor at the joint, kg m²; null: the model's."
    )
    friction_loss: float | None = Field(
        default=None, ge=0, le=1e4, description="Dry friction, N m; null: the model's."
    )
    damping: float | None = Field(
        default=None, ge=0, le=1e5, description="The joint's own, N m s/rad; null: the model's."
    )


def gains(servo: Servo, effort: float | None) -> tuple[float, float]:
    """kp and kd of the servo at a joint. effort: its greatest torque in N m; None: it has no limit.

    Raises ValueError if kp is to follow from an effort that there is not.
    """
    kp = _PER_EFFORT * effort if servo.kp is None and effort is not None else servo.kp
    if kp is None:
        raise ValueError("a servo needs a kp where no greatest torque is known")
    return kp, _DAMPING_S * kp if servo.kd is None else servo.kd


class Fit(Strict):
    """Colliding meshes that a simple shape replaces, fitted to each mesh's bounding box; what is drawn, and
    masses and inertias, stay."""

    geoms: Patterns = Field(default=[".*"], description=f"Geoms; those that are meshes count. {PATTERNS}")
    shape: Literal["box", "capsule", "cylinder", "ellipsoid", "sphere"] = "box"


class Pose(Strict):
    """Where an episode begins and what actions are about; kept as the model's keyframe `home`."""

    keyframe: Annotated[str, Field(min_length=1, max_length=LONGEST_NAME)] | None = Field(
        default=None, description="The model's keyframe that it follows; null: the model's initial state."
    )
    joints: Annotated[dict[Pattern, Real], Field(max_length=MOST_MEMBERS)] = Field(
        default={}, description=f"Positions, rad or m, in place of those. {PATTERNS}"
    )
    height: Real | None = Field(
        default=None,
        description="Of the root above the world's origin, m; null: the lowest point that can touch the "
        "floor rests on it.",
    )


Collide = Literal["declared", "feet", "floor"] | Patterns


class ModelEdits(Strict):
    """Changes of a model before it is compiled, in this order."""

    floor: bool = Field(
        default=False, description="Add a plane at height 0, if nothing of the world can be touched."
    )
    primitives: list[Fit] = Field(
        default=[],
        max_length=MOST_MEMBERS,
        description="Meshes to replace; the first that names a geom counts.",
    )
    feet: Patterns | None = Field(default=None, description=f"The feet's bodies. {PATTERNS}")
    collide: Collide = Field(
        default="declared",
        description="declared: as in the model. feet: only the geoms of the feet's bodies, with the world. "
        "floor: all that collide in the model, but with the world alone and not with each other. Or geoms, "
        f"which collide with the world alone. {PATTERNS}",
    )
    friction: float | None = Field(
        default=None,
        ge=0.01,
        le=10,
        description="Sliding friction of the moving geoms that collide, whatever they touch; null: the "
        "larger one of both geoms in the model.",
    )
    servos: list[Servo] = Field(default=[], max_length=MOST_MEMBERS, description="Position servos on joints.")
    integrator: Literal["euler", "implicitfast"] | None = Field(
        default=None,
        description="implicitfast damps stiff servos where euler blows up; null: implicitfast if there are "
        "servos here, otherwise the model's.",
    )
    pose: Pose | None = Field(default=None, description="null: as the model's file has it.")
