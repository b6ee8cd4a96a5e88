"""How a policy's action becomes the actuators' controls."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from core.bounds import FreeOptions, Real
from core.documents import Strict
from core.environments.terms.inventory import ActuatorKind, Inventory
from core.environments.terms.term import DELAY, Array, Delay, Kinds, Need, Term
from core.patterns import PATTERNS, Patterns, PerName, matching

if TYPE_CHECKING:
    from core.environments.terms.step import ModelIndex, Step

_SCALE = f"One number, or by joint. {PATTERNS}"


class Action(Term):
    """What happens to an action before it is a control: it comes late, is smoothed, and pushes as far as the
    motor can. Terms see the policy's own action."""

    noun = "action"

    delay: Delay | None = Field(default=None, description=f"After which an action arrives. {DELAY}")
    smoothing: float = Field(
        default=0.0,
        ge=0,
        lt=1,
        description="The share s of the last smoothed action in the next: s · last + (1 - s) · action.",
    )
    torque_speed_curve: bool = Field(
        default=False,
        description="In each control step, a servo with a `velocity_limit` pushes at most as its motor can "
        "at the speed that the joint has when the step begins.",
    )


class ActionTerm(Action):
    """An action of a package, whose numbers are no joints'."""

    def names(self, model: Inventory) -> Sequence[str]:
        """Of its numbers. What the term names is in the model."""
        raise NotImplementedError

    def controls(self, action: Array, step: "Step", model: "ModelIndex") -> Array:
        """The controls [nu] of an action [n]. step: `after` is what is before the step that they move."""
        raise NotImplementedError


ACTIONS = Kinds(ActionTerm, "names", "controls")


class ControlAction(Action):
    """±1 is an end of a control's range; without a range, the action is the control itself."""

    kind: Literal["control"] = "control"
    scaled: bool = Field(
        default=True, description="false: the action is the control itself, whatever the range."
    )


class JointAction(Action):
    """An action for each joint that one of its parts drives; the other joints keep the pose. Its numbers are
    in the actuators' order."""

    @property
    def parts(self) -> Sequence["JointPart"]:
        """Those that drive joints, each of which has an actuator of the part's kind."""
        raise NotImplementedError

    @property
    def needed(self) -> frozenset[Need]:
        is_about_it = any(isinstance(part, PositionPart) and part.about == "reference" for part in self.parts)
        return frozenset({"reference"}) if is_about_it else frozenset()

    @property
    def follows_encoders(self) -> bool:
        """Whether position servos follow what the encoders read."""
        return any(isinstance(part, PositionPart) and part.encoder_bias for part in self.parts)


class JointPart(Strict):
    """How actions become the controls of some joints.

    actuator: the kind that they have. what: such actuators, in words.
    """

    actuator: ClassVar[ActuatorKind]
    what: ClassVar[str]

    joints: Patterns | None = Field(
        default=None,
        description=f"Those that are acted on; null: all with an actuator. The others' position servos keep "
        f"the pose. {PATTERNS}",
    )

    @property
    def parts(self) -> Sequence["JointPart"]:
        return [self]

    def drives(self, joint: str) -> bool:
        """Whether it drives the joint, if that has an actuator."""
        return self.joints is None or bool(matching(self.joints, [joint]))


class PositionPart(JointPart):
    """A target for each joint's servo: its position in the pose, or in the reference, plus the action times a
    scale."""

    actuator = "position"
    what = "position servo"

    kind: Literal["joint_position"] = "joint_position"
    scale: Real | PerName | None = Field(
        default=None,
        description="rad or m for an action of 1; null: where half of the servo's greatest force pushes, or "
        f"0.25 where it has no limit. {_SCALE}",
    )
    about: Literal["pose", "reference"] = Field(
        default="pose",
        description="What an action of 0 asks for: the joint's position in the pose, or where the reference "
        "has it after the step. A decoder that learns about the reference moves tasks with one alone.",
    )
    encoder_bias: bool = Field(
        default=False,
        description="Position servos follow what the encoders read: the episode's bias of `joint_positions` "
        "in the observation is taken from their targets.",
    )


class VelocityPart(JointPart):
    """A velocity for each joint's servo: the action times a scale, as for wheels."""

    actuator = "velocity"
    what = "velocity servo"

    kind: Literal["joint_velocity"] = "joint_velocity"
    scale: Real | PerName | None = Field(
        default=None,
        description="rad/s or m/s for an action of 1; null: the servo's `velocity_limit`, or 1 where it has "
        f"none. {_SCALE}",
    )


class EffortPart(JointPart):
    """A torque or force on each joint: the action times a scale."""

    actuator = "motor"
    what = "motor"

    kind: Literal["joint_effort"] = "joint_effort"
    scale: Real | PerName | None = Field(
        default=None,
        description="N m or N for an action of 1; null: the motor's greatest, or 1 where it has no limit. "
        f"{_SCALE}",
    )


class JointPositionAction(PositionPart, JointAction):
    """A target for each joint's servo: its position in the pose, or in the reference, plus the action times a
    scale."""


class JointVelocityAction(VelocityPart, JointAction):
    """A velocity for each joint's servo: the action times a scale, as for wheels."""


class JointEffortAction(EffortPart, JointAction):
    """A torque or force on each joint: the action times a scale."""


AnyJointPart = Annotated[PositionPart | VelocityPart | EffortPart, Field(discriminator="kind")]


class MixedAction(JointAction):
    """Joints that are driven in several ways, as legs by positions and wheels by velocities."""

    kind: Literal["mixed"] = "mixed"
    terms: Annotated[list[AnyJointPart], Field(min_length=1, max_length=16)] = Field(
        description="How some joints are driven; each joint by one term at most."
    )

    @property
    def parts(self) -> Sequence[JointPart]:
        return self.terms


_OfTheBody = ControlAction | JointPositionAction | JointVelocityAction | JointEffortAction | MixedAction


class DecoderAction(Action):
    """An intention, which the decoder of another job's policy turns into that job's own action.

    The last three fields say what the decoder is; a submission fills them in.
    """

    kind: Literal["decoder"] = "decoder"
    job: Annotated[str, Field(pattern=r"^[0-9a-f]{12}-[0-9a-f]{10}$")] = Field(
        description="A training of this body that succeeded and has an intention network (`network` of PPO)."
    )
    which: Literal["last", "best"] = Field(
        default="last", description="Its policy at the end, or that of its best evaluation."
    )
    reach: float = Field(
        default=3.5,
        gt=0,
        le=100,
        description="An action of ±1 is an intention of ± this. It is to cover the job's own: those of a rat "
        "that followed forty clips were ±1.8 on average.",
    )
    latent: int | None = Field(
        default=None, ge=1, le=1024, description="How many numbers an intention has. Filled in."
    )
    sees: Annotated[list[FreeOptions], Field(max_length=64)] | None = Field(
        default=None, description="The terms of the observation that the decoder sees. Filled in."
    )
    moves: Annotated[_OfTheBody, Field(discriminator="kind")] | None = Field(
        default=None, description="The action that the decoder gives. Filled in."
    )

    @property
    def needed(self) -> frozenset[Need]:
        return frozenset() if self.moves is None else self.moves.needed

    @model_validator(mode="after")
    def _leaves_the_rest_to_the_job(self) -> Self:
        for name, field in Action.model_fields.items():
            if getattr(self, name) != field.default:
                raise ValueError(f"{name} is that of the job whose decoder acts; leave it out")
        return self


AnyAction = Annotated[_OfTheBody | DecoderAction, ACTIONS]


def of_the_body(action: Action) -> Action:
    """The action that moves the body: what a decoder gives, or the action itself."""
    if not isinstance(action, DecoderAction):
        return action
    return action.moves or ControlAction()
