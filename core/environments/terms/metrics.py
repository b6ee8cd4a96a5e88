"""What each step reports besides the terms of its reward: numbers by name."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from core.environments.terms.commands import HEIGHT, PITCH
from core.environments.terms.term import Array, Kinds, OfBody, Term

if TYPE_CHECKING:
    from core.environments.terms.step import ModelIndex, Step

Motion = Literal[
    "x_position",
    "y_position",
    "height",
    "x_velocity",
    "y_velocity",
    "distance_from_origin",
]


class MetricTerm(Term):
    """`measure` is a number [] by the name of each metric."""


METRICS = Kinds(MetricTerm, "measure")
# The units of these terms' metrics, by name. The `joint_error` of a slide is in m.
UNITS: Mapping[str, str] = {
    **dict.fromkeys(("x_position", "y_position", "height", "distance_from_origin"), "m"),
    **dict.fromkeys(("x_velocity", "y_velocity", "velocity_error"), "m/s"),
    **dict.fromkeys(("distance_from_start", "position_error", "height_error"), "m"),
    **dict.fromkeys(("root_error", "body_error"), "m"),
    **dict.fromkeys(("root_turn_error", "joint_error", "pitch_error"), "rad"),
    "turn_error": "rad/s",
    "clip_followed": "1",
}


class Travel(OfBody, MetricTerm):
    """Where a body is and how fast it moves, along the world's axes: m, m/s."""

    kind: Literal["travel"] = "travel"
    of: Literal["body", "centre_of_mass"] = Field(
        default="body", description="The body itself, or the centre of mass of its subtree."
    )
    report: Annotated[list[Motion], Field(min_length=1, max_length=6)] = Field(
        default=["x_position", "y_position", "distance_from_origin", "x_velocity", "y_velocity"],
        description="The metrics' names; the distance is in three dimensions.",
    )

    def measure(self, step: "Step", model: "ModelIndex") -> Mapping[str, Array]:
        """[] each."""
        body = model.body(self.body)
        after, velocity = model.place(step.after, body, self.of), model.velocity(step, body, self.of)
        all_of_them = {
            "x_position": after[0],
            "y_position": after[1],
            "height": after[2],
            "x_velocity": velocity[0],
            "y_velocity": velocity[1],
            "distance_from_origin": step.xp.linalg.norm(after),
        }
        return {name: all_of_them[name] for name in self.report}


class DistanceFromStart(MetricTerm):
    """`distance_from_start`: how far the root is from where the episode began, along the ground, in m."""

    remembers = frozenset({"start"})

    kind: Literal["distance_from_start"] = "distance_from_start"

    def measure(self, step: "Step", model: "ModelIndex") -> Mapping[str, Array]:
        """[]"""
        position = model.position(step.after, model.root)
        return {self.kind: step.xp.linalg.norm(position[:2] - step.start[:2])}


class FollowedCommand(MetricTerm):
    """How far the root is from the command: `velocity_error` in m/s, `turn_error` in rad/s; `height_error` in
    m and `pitch_error` in rad where these are told."""

    needs = frozenset({"velocity_command", "free_root"})

    kind: Literal["followed_command"] = "followed_command"

    def measure(self, step: "Step", model: "ModelIndex") -> Mapping[str, Array]:
        """[] each."""
        moving, turning = model.base_linear_velocity(step)[:2], model.base_angular_velocity(step)[2]
        errors = {
            "velocity_error": step.xp.linalg.norm(moving - step.command[:2]),
            "turn_error": abs(turning - step.command[2]),
        }
        if model.num_commands > HEIGHT:
            errors["height_error"] = abs(model.position(step.after, model.root)[2] - step.command[HEIGHT])
        if model.num_commands > PITCH:
            errors["pitch_error"] = abs(model.pitch(step) - step.command[PITCH])
        return errors


class FollowedPosition(MetricTerm):
    """`position_error`: how far the root is along the ground from the command's point, in m."""

    needs = frozenset({"position_command", "free_root"})

    kind: Literal["followed_position"] = "followed_position"

    def measure(self, step: "Step", model: "ModelIndex") -> Mapping[str, Array]:
        """[]"""
        away = model.position(step.after, model.root)[:2] - step.target
        return {"position_error": step.xp.linalg.norm(away)}


class FollowedReference(MetricTerm):
    """How far the body is from the reference: `root_error` in m, `root_turn_error` in rad, `joint_error`, the
    joints' mean in rad or m, and `body_error`, the bodies' mean in m. `clip_followed` adds up, over an
    episode, to the share of the way from its start to the clip's end: 1 where it got there."""

    needs = frozenset({"reference"})

    kind: Literal["followed_reference"] = "followed_reference"

    def measure(self, step: "Step", model: "ModelIndex") -> Mapping[str, Array]:
        """[] each."""
        xp, bodies = step.xp, model.followed.offsets(step, model.followed.compared)
        return {
            "root_error": xp.sqrt(xp.sum(model.followed.root_offset(step) ** 2)),
            "root_turn_error": model.followed.root_turn(step),
            "joint_error": xp.mean(abs(model.followed.joint_offsets(step))),
            "body_error": xp.mean(xp.sqrt(xp.sum(bodies**2, -1))),
            "clip_followed": step.reference.share,
        }


AnyMetric = Annotated[
    Travel | DistanceFromStart | FollowedCommand | FollowedPosition | FollowedReference, METRICS
]
