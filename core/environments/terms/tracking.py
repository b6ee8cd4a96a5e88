"""Terms of commands: what the policy is told, and how well it follows.

Names and forms are those of legged_gym, Isaac Lab and mjlab.
"""

from collections.abc import Iterable
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from core.environments.info import Slice, named
from core.environments.terms.commands import HEIGHT, PITCH
from core.environments.terms.inventory import ModelParts
from core.environments.terms.observations import ObservationTerm
from core.environments.terms.term import Array, RewardTerm

if TYPE_CHECKING:
    from core.environments.terms.step import ModelIndex, Step


class Command(ObservationTerm):
    """The command: forward and left in m/s, turn in rad/s, and what else it has; or a point ahead and to the
    left, in m."""

    needs = frozenset({"command"})

    kind: Literal["command"] = "command"

    def size(self, parts: ModelParts) -> int:
        return len(parts.command)

    def slices(self, parts: ModelParts) -> Iterable[Slice]:
        for name, unit in parts.command:
            yield named("command", (name,), unit)

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return step.command


class TrackLinearVelocity(RewardTerm):
    """exp(−‖v_xy − c_xy‖² / σ²): 1 where the root moves as commanded."""

    needs = frozenset({"velocity_command", "free_root"})
    usual_weight = 2.0

    kind: Literal["track_linear_velocity"] = "track_linear_velocity"
    tolerance: float = Field(default=0.5, gt=0, le=100, description="Error at which the term is 1/e, in m/s.")

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        error = model.base_linear_velocity(step)[:2] - step.command[:2]
        return step.xp.exp(-step.xp.sum(error**2) / self.tolerance**2)


class TrackAngularVelocity(RewardTerm):
    """exp(−(ω_z − c_turn)² / σ²): 1 where the root turns as commanded."""

    needs = frozenset({"velocity_command", "free_root"})
    usual_weight = 2.0

    kind: Literal["track_angular_velocity"] = "track_angular_velocity"
    tolerance: float = Field(
        default=0.5, gt=0, le=100, description="Error at which the term is 1/e, in rad/s."
    )

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        error = model.base_angular_velocity(step)[2] - step.command[2]
        return step.xp.exp(-(error**2) / self.tolerance**2)


class TrackHeight(RewardTerm):
    """exp(−(z − c_height)² / σ²): 1 where the root is as high above the world's origin as commanded."""

    needs = frozenset({"command_height", "free_root"})

    kind: Literal["track_height"] = "track_height"
    tolerance: float = Field(default=0.1, gt=0, le=100, description="Error at which the term is 1/e, in m.")

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        error = model.position(step.after, model.root)[2] - step.command[HEIGHT]
        return step.xp.exp(-(error**2) / self.tolerance**2)


class TrackPitch(RewardTerm):
    """exp(−(θ − c_pitch)² / σ²), θ = atan2(g_x, −g_z) of the projected gravity g: 1 where the root leans
    forward as commanded."""

    needs = frozenset({"command_pitch", "free_root"})

    kind: Literal["track_pitch"] = "track_pitch"
    tolerance: float = Field(default=0.2, gt=0, le=10, description="Error at which the term is 1/e, in rad.")

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return step.xp.exp(-((model.pitch(step) - step.command[PITCH]) ** 2) / self.tolerance**2)


class TrackPosition(RewardTerm):
    """1 − tanh(d / σ), with d the distance along the ground from the root to the commanded point.

    Source: Isaac Lab's `position_command_error_tanh`.
    """

    needs = frozenset({"position_command", "free_root"})

    kind: Literal["track_position"] = "track_position"
    tolerance: float = Field(default=2.0, gt=0, le=1000, description="σ in m: the term is 0.24 there.")

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        away = model.position(step.after, model.root)[:2] - step.target
        # Slightly above 0, where the norm has no derivative.
        distance = step.xp.sqrt(step.xp.sum(away**2) + 1e-12)
        return 1.0 - step.xp.tanh(distance / self.tolerance)


TrackingReward = TrackLinearVelocity | TrackAngularVelocity | TrackHeight | TrackPitch | TrackPosition
