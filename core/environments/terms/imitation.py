"""Terms of a body that follows a reference: how near it is, and what its policy sees of it.

Bodies are compared about an anchor: a reference's bodies stand where its anchor would be if that were, on the
ground, where the body's anchor is, and headed as that does. Kernels are exp(−e² / σ²), with e² a mean over
joints or bodies.
Source: Peng et al., DeepMimic (2018); Liao et al., BeyondMimic (2025), and mjlab's task `tracking`;
track-mjx (Zhang et al., 2025).
"""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from core.environments.info import Slice, named
from core.environments.terms import rotations
from core.environments.terms.inventory import ModelParts
from core.environments.terms.observations import ObservationTerm
from core.environments.terms.reference import Frame
from core.environments.terms.term import Array, RewardTerm
from core.patterns import PATTERNS, Patterns

if TYPE_CHECKING:
    from core.environments.terms.step import ModelIndex, Step

_AXES = ("x", "y", "z")
_Tolerance = Annotated[float, Field(gt=0, le=100)]
_JOINTS = f"null: all hinges and slides. {PATTERNS}"


def _kernel(square: Array, tolerance: float, step: "Step") -> Array:
    return step.xp.exp(-square / tolerance**2)


def _mean_square(error: Array, step: "Step") -> Array:
    """The mean over rows of the squared length, []. error: [rows, 3]."""
    return step.xp.mean(step.xp.sum(error**2, -1))


class TrackRootPosition(RewardTerm):
    """exp(−‖p − p*‖² / σ²): 1 where the root is where the reference has it."""

    needs = frozenset({"reference"})

    kind: Literal["track_root_position"] = "track_root_position"
    tolerance: _Tolerance = Field(default=0.3, description="σ in m: the term is 1/e there.")

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return _kernel(step.xp.sum(model.followed.root_offset(step) ** 2), self.tolerance, step)


class TrackRootOrientation(RewardTerm):
    """exp(−θ² / σ²), with θ the angle between the root and the reference's."""

    needs = frozenset({"reference"})

    kind: Literal["track_root_orientation"] = "track_root_orientation"
    tolerance: _Tolerance = Field(default=0.4, description="σ in rad.")

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return _kernel(model.followed.root_turn(step) ** 2, self.tolerance, step)


class TrackJoints(RewardTerm):
    """exp(−mean (q − q*)² / σ²): 1 where the joints are as in the reference."""

    needs = frozenset({"reference"})

    kind: Literal["track_joints"] = "track_joints"
    joints: Patterns | None = Field(default=None, description=_JOINTS)
    tolerance: _Tolerance = Field(default=0.3, description="σ in rad, or m of slides.")

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return _kernel(
            step.xp.mean(model.followed.joint_offsets(step, model.joint_positions(self.joints)) ** 2),
            self.tolerance,
            step,
        )


class TrackJointVelocities(RewardTerm):
    """exp(−mean (q̇ − q̇*)² / σ²): 1 where the joints move as in the reference."""

    needs = frozenset({"reference"})

    kind: Literal["track_joint_velocities"] = "track_joint_velocities"
    joints: Patterns | None = Field(default=None, description=_JOINTS)
    tolerance: _Tolerance = Field(default=3.0, description="σ in rad/s, or m/s of slides.")

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        places = step.places(model.joint_velocities(self.joints))
        error = step.after.qvel[places] - step.reference.now.qvel[places]
        return _kernel(step.xp.mean(error**2), self.tolerance, step)


class TrackBodyPositions(RewardTerm):
    """exp(−mean ‖x − x*‖² / σ²): 1 where the bodies are, about the anchor, where the reference has them."""

    needs = frozenset({"reference"})

    kind: Literal["track_body_positions"] = "track_body_positions"
    tolerance: _Tolerance = Field(default=0.3, description="σ in m.")

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        rows = model.followed.compared
        return _kernel(_mean_square(model.followed.offsets(step, rows), step), self.tolerance, step)


class TrackBodyOrientations(RewardTerm):
    """exp(−mean θ² / σ²), with θ the angle of each body to the reference's, headed as the anchor is."""

    needs = frozenset({"reference"})

    kind: Literal["track_body_orientations"] = "track_body_orientations"
    tolerance: _Tolerance = Field(default=0.4, description="σ in rad.")

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        turns = model.followed.turns(step, model.followed.compared)
        return _kernel(step.xp.mean(turns**2), self.tolerance, step)


class TrackBodyVelocities(RewardTerm):
    """½ exp(−mean ‖v − v*‖² / σ²) + ½ exp(−mean ‖ω − ω*‖² / σ'²) of the bodies, along the world's axes."""

    needs = frozenset({"reference"})

    kind: Literal["track_body_velocities"] = "track_body_velocities"
    tolerance: _Tolerance = Field(default=1.0, description="σ in m/s.")
    angular_tolerance: _Tolerance = Field(default=3.14, description="σ' in rad/s.")

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        rows, now = model.followed.compared, step.reference.now
        linear, angular = model.followed.velocities(step.after.derived, step.xp)
        return 0.5 * (
            _kernel(_mean_square(linear[rows] - now.linear_velocities[rows], step), self.tolerance, step)
            + _kernel(
                _mean_square(angular[rows] - now.angular_velocities[rows], step), self.angular_tolerance, step
            )
        )


class TrackEndEffectors(RewardTerm):
    """exp(−mean ‖x − x*‖² / σ²) of the end effectors alone: as `track_body_positions`, and sharper."""

    needs = frozenset({"reference"})

    kind: Literal["track_end_effectors"] = "track_end_effectors"
    tolerance: _Tolerance = Field(default=0.1, description="σ in m.")

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        rows = model.followed.end_effectors
        return _kernel(_mean_square(model.followed.offsets(step, rows), step), self.tolerance, step)


def _ahead(names: Sequence[str], parts: ModelParts) -> Iterable[str]:
    """The names of a frame's numbers, in each frame ahead."""
    return (f"{name} t+{number + 1}" for number in range(parts.frames_ahead) for name in names)


Shown = Literal["root_position", "root_orientation", "joints", "joint_velocities", "bodies"]


class ReferenceAhead(ObservationTerm):
    """What comes next in the reference, in each of its frames ahead and in the root's frame: the way to its
    root in m, where that turns x and y to, joints less those of the pose, and the ways of the bodies from
    where they are to where they are to be."""

    needs = frozenset({"reference"})

    kind: Literal["reference"] = "reference"
    show: Annotated[list[Shown], Field(min_length=1, max_length=5)] = Field(
        default=["root_position", "root_orientation", "joints"], description="Of each frame."
    )

    def size(self, parts: ModelParts) -> int:
        return sum(one.size for one in self.slices(parts))

    def slices(self, parts: ModelParts) -> Iterable[Slice]:
        for shown in dict.fromkeys(self.show):
            names, unit = self._numbers(shown, parts)
            yield named(f"reference_{shown}", _ahead(names, parts), unit)

    def _numbers(self, shown: Shown, parts: ModelParts) -> tuple[list[str], str]:
        """The names and the unit of the numbers of a frame."""
        match shown:
            case "root_position":
                return list(_AXES), "m"
            case "root_orientation":
                return [f"{axis}{part}" for axis in "xy" for part in _AXES], "1"
            case "joints":
                return [joint.name for joint in parts.model.moving_joints()], "rad, m"
            case "joint_velocities":
                return [joint.name for joint in parts.model.moving_joints()], "rad/s, m/s"
            case "bodies":
                return [f"{body} {axis}" for body in parts.compared for axis in _AXES], "m"

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        ahead = step.reference.ahead
        return step.xp.concatenate(
            [self._values(shown, ahead, step, model).ravel() for shown in dict.fromkeys(self.show)]
        )

    def _values(self, shown: Shown, ahead: Frame, step: "Step", model: "ModelIndex") -> Array:
        """[frames, …]"""
        xp, start = step.xp, model.root_position
        root, back = step.after.qpos[start : start + 3], model.followed.turn_back(step)
        match shown:
            case "root_position":
                return rotations.rotated(back, ahead.qpos[:, start : start + 3] - root, xp)
            case "root_orientation":
                turn = rotations.product(back, ahead.qpos[:, start + 3 : start + 7], xp)
                return rotations.two_axes(turn, xp)
            case "joints":
                places = model.joint_positions(None)
                return ahead.qpos[:, places] - step.array(model.pose[places])
            case "joint_velocities":
                return ahead.qvel[:, model.joint_velocities(None)]
            case "bodies":
                rows = model.followed.compared
                here = step.after.derived["xpos"][model.followed.bodies[rows]]
                return rotations.rotated(back, ahead.positions[:, rows] - here, xp)


ImitationReward = (
    TrackRootPosition
    | TrackRootOrientation
    | TrackJoints
    | TrackJointVelocities
    | TrackBodyPositions
    | TrackBodyOrientations
    | TrackBodyVelocities
    | TrackEndEffectors
)
