"""A battery: a test of a trained policy that follows velocity commands or clips; no numerical code."""

from collections.abc import Sequence
from typing import Annotated, cast

from pydantic import Field

from core.documents import Strict
from core.environments.terms.commands import Push, VelocityCommand
from core.environments.terms.task import TaskOptions

# Forward and left in m/s, turn in rad/s.
COMMANDS = (
    (1.0, 0.0, 0.0),
    (0.5, 0.0, 0.0),
    (-0.5, 0.0, 0.0),
    (0.0, 0.4, 0.0),
    (0.0, -0.4, 0.0),
    (0.5, 0.0, 0.8),
    (0.5, 0.0, -0.8),
    (0.0, 0.0, 0.0),
)
# The command under which smoothness is judged.
STRAIGHT_ON = COMMANDS[1]
# An episode's first seconds, which are not measured: the body gets going.
SETTLING_S = 1.5
# Tracking is exp(−e² / TOLERANCE²), e in m/s or rad/s.
TOLERANCE = 0.5

# The bound of a quantity that is positive.
Bound = Annotated[float, Field(gt=0, le=1000)]
Command = tuple[float, float, float]


class Bounds(Strict):
    """The bounds that a policy must hold to pass; null: the quantity is measured, and not judged."""

    falls: float = Field(default=0.01, ge=0, le=1, description="At most this share of the episodes falls.")
    tracking: float = Field(
        default=0.9,
        ge=0,
        le=1,
        description="At least this mean of exp(−e² / 0.25), of the velocity and of the turning each.",
    )
    action_change: Bound | None = Field(
        default=None, description="RMS of the legs' actions' change from one action to the next."
    )
    target_change: Bound | None = Field(
        default=None, description="RMS of the same change as the legs' servos' targets have it, in rad."
    )
    torso_rate: Bound | None = Field(
        default=None, description="RMS of the root's rate of roll and pitch, in rad/s."
    )
    yaw_rate: Bound | None = Field(default=None, description="RMS of the root's yaw rate, in rad/s.")
    leg_velocity: Bound | None = Field(
        default=None, description="RMS of the legs' joints' velocities, in rad/s."
    )
    reached: float = Field(
        default=0.95,
        ge=0,
        le=1,
        description="Of clips: at least this share of episodes comes to the end.",
    )
    root_error: Bound | None = Field(
        default=0.1, description="Of clips: how far the root is from theirs, at most, in the mean, in m."
    )
    joint_error: Bound | None = Field(
        default=0.2, description="Of clips: how far the joints are from theirs, at most, in the mean, in rad."
    )


class BatterySpec(Strict):
    """Eight commands from several starts, in C MuJoCo with the model's own solver; of a task that follows
    clips, every clip from moments that are spread over it, each time to its end."""

    starts: int = Field(default=32, ge=1, le=512, description="Episodes for each command or clip.")
    seconds: float = Field(
        default=8.0,
        ge=2,
        le=120,
        description="Length of an episode under a command; the first 1.5 s are not measured.",
    )
    push: Push | None = Field(
        default=None, description="Pushes in every episode, in place of the task's own; null: none."
    )
    bounds: Bounds = Bounds()


def commands_within(trained: VelocityCommand) -> Sequence[Command]:
    """The battery's commands, clipped to the ranges that the policy was trained on; each is there once."""
    return list(dict.fromkeys(clipped(command, trained) for command in COMMANDS))


def clipped(command: Command, trained: VelocityCommand) -> Command:
    """The nearest command in the trained ranges."""
    ranges = (trained.forward, trained.left, trained.turn)
    return cast(
        "Command",
        tuple(min(max(part, low), high) for part, (low, high) in zip(command, ranges, strict=True)),
    )


def can_be_tested(task: TaskOptions) -> bool:
    """Whether the task tells its policy a velocity, or has a reference, whose clips are then the cases."""
    return isinstance(task.command, VelocityCommand) or task.reference is not None


def battery_options(options: TaskOptions, spec: BatterySpec) -> TaskOptions:
    """The task as the battery runs it: each episode has one command, if any, and only the battery's pushes.
    Without a command it reports the usual metrics."""
    kept = [event for event in options.events if event.kind != "push"]
    pushes = [] if spec.push is None else [spec.push]
    if options.command is None:
        return options.model_copy(update={"events": [*kept, *pushes], "metrics": None})
    longer = options.command.model_copy(update={"every_s": 2 * spec.seconds, "heading": None})
    return options.model_copy(update={"command": longer, "events": [*kept, *pushes]})
