"""Terms of robots that walk by command: of the root in its own frame, and of joints about the pose.

Names and forms are those of legged_gym, Isaac Lab, mjlab and Playground. The root has a free joint: its
qvel is the linear velocity along the world's axes and the angular velocity about the root's own.
"""

from collections.abc import Iterable
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from core.bounds import MOST_MEMBERS
from core.environments.info import Slice, named
from core.environments.terms.inventory import ModelParts
from core.environments.terms.observations import ObservationTerm
from core.environments.terms.sensed import CLOCK, Sensed
from core.environments.terms.term import Array, CostTerm, RewardTerm
from core.patterns import PATTERNS, Pattern, Patterns, PerName

if TYPE_CHECKING:
    from core.environments.terms.step import ModelIndex, Step

_AXES = ("x", "y", "z")
Tolerances = Annotated[
    dict[Pattern, Annotated[float, Field(gt=0, le=100)]], Field(min_length=1, max_length=MOST_MEMBERS)
]


class BaseLinearVelocity(ObservationTerm):
    """Rᵀ v: the root's velocity along its own axes, in m/s."""

    needs = frozenset({"free_root"})

    kind: Literal["base_linear_velocity"] = "base_linear_velocity"

    def size(self, parts: ModelParts) -> int:
        return 3

    def slices(self, parts: ModelParts) -> Iterable[Slice]:
        yield named("base_linear_velocity", _AXES, "m/s")

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return model.base_linear_velocity(step)


class BaseAngularVelocity(ObservationTerm):
    """The root's angular velocity about its own axes, in rad/s."""

    needs = frozenset({"free_root"})

    kind: Literal["base_angular_velocity"] = "base_angular_velocity"

    def size(self, parts: ModelParts) -> int:
        return 3

    def slices(self, parts: ModelParts) -> Iterable[Slice]:
        yield named("base_angular_velocity", _AXES, "rad/s")

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return model.base_angular_velocity(step)


class ProjectedGravity(ObservationTerm):
    """Rᵀ (0, 0, −1): the direction of gravity in the root's frame."""

    needs = frozenset({"free_root"})

    kind: Literal["projected_gravity"] = "projected_gravity"

    def size(self, parts: ModelParts) -> int:
        return 3

    def slices(self, parts: ModelParts) -> Iterable[Slice]:
        yield named("projected_gravity", _AXES, "1", -1.0, 1.0)

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return model.projected_gravity(step)


class _OfJoints(ObservationTerm):
    joints: Patterns | None = Field(default=None, description=f"null: all hinges and slides. {PATTERNS}")

    def size(self, parts: ModelParts) -> int:
        return len(parts.model.moving_joints(self.joints))

    def _named(self, name: str, parts: ModelParts, units: tuple[str, str]) -> Iterable[Slice]:
        joints = parts.model.moving_joints(self.joints)
        kinds = {joint.type for joint in joints}
        unit = units[0] if kinds == {"hinge"} else units[1] if kinds == {"slide"} else ", ".join(units)
        yield named(name, (joint.name for joint in joints), unit)

    def _sensed(
        self, name: str, model: "ModelIndex", parts: ModelParts, units: tuple[str, str], less: Iterable[float]
    ) -> Sensed:
        """All joints are measured, of which the term has some."""
        [whole] = type(self)()._named(name, parts, units)
        everywhere = model.joints(None).tolist()
        places = tuple(everywhere.index(joint) for joint in model.joints(self.joints).tolist())
        return Sensed(name, whole.components, whole.unit, places, tuple(less))


class JointPositions(_OfJoints):
    """q − q*: positions of joints less those of the pose, in rad or m."""

    kind: Literal["joint_positions"] = "joint_positions"

    def slices(self, parts: ModelParts) -> Iterable[Slice]:
        return self._named("joint_positions", parts, ("rad", "m"))

    def sensed(self, model: "ModelIndex", parts: ModelParts) -> Sensed:
        pose = model.pose[model.joint_positions(self.joints)].tolist()
        return self._sensed("joint_positions", model, parts, ("rad", "m"), pose)

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        places = model.joint_positions(self.joints)
        return step.after.qpos[places] - step.array(model.pose[places])


class JointVelocities(_OfJoints):
    """q̇: velocities of joints, in rad/s or m/s."""

    kind: Literal["joint_velocities"] = "joint_velocities"

    def slices(self, parts: ModelParts) -> Iterable[Slice]:
        return self._named("joint_velocities", parts, ("rad/s", "m/s"))

    def sensed(self, model: "ModelIndex", parts: ModelParts) -> Sensed:
        return self._sensed("joint_velocities", model, parts, ("rad/s", "m/s"), ())

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return step.after.qvel[model.joint_velocities(self.joints)]


class GaitPhase(ObservationTerm):
    """sin φ of each foot, then cos φ, with φ the phase of the gait's clock."""

    needs = frozenset({"feet", "gait"})

    kind: Literal["gait_phase"] = "gait_phase"

    def size(self, parts: ModelParts) -> int:
        return 2 * len(parts.feet)

    def slices(self, parts: ModelParts) -> Iterable[Slice]:
        for part in ("sin", "cos"):
            yield named("gait_phase", (f"{part} {foot}" for foot in range(len(parts.feet))), "1", -1.0, 1.0)

    def sensed(self, model: "ModelIndex", parts: ModelParts) -> Sensed:
        return Sensed(CLOCK, ("share of a round",), "1")

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return step.xp.concatenate([step.xp.sin(step.phases), step.xp.cos(step.phases)])


class FlatOrientation(RewardTerm):
    """exp(−‖g_xy‖² / σ²), with g the direction of gravity in the root's frame: 1 where it is upright."""

    needs = frozenset({"free_root"})

    kind: Literal["flat_orientation"] = "flat_orientation"
    tolerance: float = Field(default=0.3, gt=0, le=10, description="Sine of the tilt at which it is 1/e.")

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        sideways = model.projected_gravity(step)[:2]
        return step.xp.exp(-step.xp.sum(sideways**2) / self.tolerance**2)


class VerticalVelocity(CostTerm):
    """v_z²: the root's velocity along the world's z, in m²/s²."""

    needs = frozenset({"free_root"})
    usual_weight = 0.5

    kind: Literal["vertical_velocity"] = "vertical_velocity"

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return model.velocities(step)[2] ** 2


class RollPitchRate(CostTerm):
    """ω_x² + ω_y²: the root's angular velocity about its own x and y, in rad²/s²."""

    needs = frozenset({"free_root"})
    usual_weight = 0.05

    kind: Literal["roll_pitch_rate"] = "roll_pitch_rate"

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return step.xp.sum(model.base_angular_velocity(step)[:2] ** 2)


class Posture(CostTerm):
    """Σ w (q − q*)²: how far joints are from the pose, in rad² or m²."""

    usual_weight = 0.1

    kind: Literal["posture"] = "posture"
    weights: PerName = Field(default={".*": 1.0}, description=f"By joint; others weigh nothing. {PATTERNS}")

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        places = model.joint_positions(None)
        error = step.after.qpos[places] - step.array(model.pose[places])
        return step.xp.sum(step.array(model.per_joint(self.weights)) * error**2)


class StandStill(CostTerm):
    """Σ |q − q*| while the command is to stand: joints away from the pose, in rad or m."""

    needs = frozenset({"command"})
    usual_weight = 0.05

    kind: Literal["stand_still"] = "stand_still"

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        places = model.joint_positions(None)
        error = abs(step.after.qpos[places] - step.array(model.pose[places]))
        return step.xp.where(step.is_moving, 0.0, step.xp.sum(error))


class JointVelocityCost(CostTerm):
    """Σ q̇²: the joints' velocities, in rad²/s² or m²/s²."""

    usual_weight = 0.0005

    kind: Literal["joint_velocity"] = "joint_velocity"

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return step.xp.sum(step.after.qvel[model.joint_velocities(None)] ** 2)


class JointAcceleration(CostTerm):
    """Σ ((q̇' − q̇) / dt)²: the joints' accelerations over a step, in rad²/s⁴ or m²/s⁴."""

    usual_weight = 2.5e-7

    kind: Literal["joint_acceleration"] = "joint_acceleration"

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        places = model.joint_velocities(None)
        return step.xp.sum(((step.after.qvel[places] - step.before.qvel[places]) / step.dt) ** 2)


class JointTorque(CostTerm):
    """Σ τ²: the actuators' forces on the joints, in N² m² or N²."""

    usual_weight = 0.0002

    kind: Literal["joint_torque"] = "joint_torque"

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return step.xp.sum(step.after.derived["qfrc_actuator"][model.joint_velocities(None)] ** 2)


class VariablePosture(RewardTerm):
    """exp(−mean((q − q*)² / σ²)) over the joints that have a σ at the command's speed s = ‖c_xy‖ + |c_turn|.

    Source: mjlab's `variable_posture`.
    """

    needs = frozenset({"velocity_command"})

    kind: Literal["variable_posture"] = "variable_posture"
    standing: Tolerances = Field(
        default={".*": 0.05}, description=f"σ of joints, in rad or m, while s is below `walks_at`. {PATTERNS}"
    )
    walking: Tolerances = Field(default={".*": 0.3}, description="σ between the two.")
    running: Tolerances = Field(default={".*": 0.5}, description="σ from `runs_at` on.")
    walks_at: float = Field(default=0.05, ge=0, le=100, description="In m/s and rad/s.")
    runs_at: float = Field(default=1.5, ge=0, le=100, description="In m/s and rad/s.")

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        xp, places = step.xp, model.joint_positions(None)
        squares = (step.after.qpos[places] - step.array(model.pose[places])) ** 2
        mean = [
            xp.sum(step.array(model.inverse_squares(widths)) * squares)
            for widths in (self.standing, self.walking, self.running)
        ]
        speed = step.command_speed
        return xp.exp(
            -xp.where(speed < self.walks_at, mean[0], xp.where(speed < self.runs_at, mean[1], mean[2]))
        )


class BaseHeight(CostTerm):
    """(z − h)²: how far the root is from a height above the world's origin, in m²."""

    needs = frozenset({"free_root"})
    usual_weight = 10.0

    kind: Literal["base_height"] = "base_height"
    height: float | None = Field(default=None, ge=0, le=100, description="h in m; null: that of the pose.")

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        wanted = model.pose_height if self.height is None else self.height
        return (model.position(step.after, model.root)[2] - wanted) ** 2


class AngularMomentum(CostTerm):
    """‖L‖²: the angular momentum of the root and all that it carries, about their centre of mass, in
    kg² m⁴/s².

    Source: mjlab's `angular_momentum_penalty`, which makes arms swing.
    """

    needs = frozenset({"free_root"})
    usual_weight = 0.02

    kind: Literal["angular_momentum"] = "angular_momentum"

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return step.xp.sum(model.angular_momentum(step) ** 2)


WalkingObservation = (
    BaseLinearVelocity | BaseAngularVelocity | ProjectedGravity | JointPositions | JointVelocities | GaitPhase
)
WalkingReward = (
    FlatOrientation
    | VerticalVelocity
    | RollPitchRate
    | Posture
    | StandStill
    | JointVelocityCost
    | JointAcceleration
    | JointTorque
    | VariablePosture
    | BaseHeight
    | AngularMomentum
)
