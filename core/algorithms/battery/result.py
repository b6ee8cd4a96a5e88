"""The result of a battery; no numerical code."""

import math
from collections.abc import Sequence
from typing import Literal

from core.algorithms.battery.spec import BatterySpec, Bounds, Command
from core.documents import Stored

Quantity = Literal[
    "falls",
    "linear_tracking",
    "angular_tracking",
    "action_change",
    "target_change",
    "torso_rate",
    "yaw_rate",
    "leg_velocity",
    "reached",
    "root_error",
    "joint_error",
]
SMOOTHNESS: tuple[Quantity, ...] = (
    "action_change",
    "target_change",
    "torso_rate",
    "yaw_rate",
    "leg_velocity",
)
# In the tables over the clips' time: 2.5 MB as text.
MOST_NUMBERS = 300_000
# By what a policy that follows clips is judged.
OF_CLIPS: tuple[Quantity, ...] = ("reached", "root_error", "joint_error")


class CommandResult(Stored):
    """The episodes under one command. command: forward and left in m/s, turn in rad/s.

    linear_tracking, angular_tracking: means of exp(−e² / 0.25) over all episodes after they have settled;
    after a fall, 0. The others are root mean squares over the same steps, while the body is up: of the
    change from one action to the next of the legs' actions, and of their servos' targets, in rad (None
    without such); of the root's angular velocity about its x and y axes together, and about z, in rad/s; of
    the legs' joints' velocities, in rad/s. None: none was up.
    """

    command: Command
    episodes: int
    falls: int
    linear_tracking: float
    angular_tracking: float
    action_change: float | None = None
    target_change: float | None = None
    torso_rate: float | None = None
    yaw_rate: float | None = None
    leg_velocity: float | None = None


class ClipResult(Stored):
    """The episodes of one clip. reached: the share that came to its end. The errors are means over the steps
    of all of them: where the root is, in m, how it is turned, in rad, the joints, in rad, and the bodies, in
    m."""

    clip: str
    episodes: int
    reached: float
    root_error: float
    root_turn_error: float
    joint_error: float
    body_error: float


# Rows are parts of a clip's time of equal length, columns joints or bodies; None where no episode was.
Table = list[list[float | None]]


class ClipErrors(Stored):
    """How far joints, in rad (slides in m), and bodies, in m, were off in each part of a clip: the means over
    the steps of all episodes. The table of bodies is about the reference's anchor, as `body_error` is."""

    clip: str
    seconds: float
    joints: Table
    bodies: Table


class OverTime(Stored):
    """joints, bodies: the names of the columns. clips: of more than `MOST_NUMBERS` allows, those of which
    fewest episodes came to the end, and of equal ones those whose joints were furthest off."""

    joints: list[str]
    bodies: list[str]
    clips: list[ClipErrors]


class Criterion(Stored):
    """A quantity, its bound, and whether the policy holds it. `falls` and `reached` are shares of all
    episodes."""

    quantity: Quantity
    value: float | None
    bound: float
    met: bool


class BatteryResult(Stored):
    """passed: whether every criterion is met. took_s: seconds that its episodes took. legs: their joints.

    commands, clips: one of the two is empty. over_time: of clips.
    """

    passed: bool
    criteria: list[Criterion]
    commands: list[CommandResult]
    clips: list[ClipResult] = []
    over_time: OverTime | None = None
    spec: BatterySpec
    seed: int
    engine: str
    legs: list[str]
    took_s: float


def judged(
    commands: Sequence[CommandResult], straight_on: Command, bounds: Bounds
) -> tuple[bool, list[Criterion]]:
    """Whether the policy passes, and by what. straight_on: the command under which smoothness is judged."""
    straight = next(row for row in commands if row.command == straight_on)
    values = overall(commands)
    limits: dict[Quantity, float | None] = {
        "falls": bounds.falls,
        "linear_tracking": bounds.tracking,
        "angular_tracking": bounds.tracking,
        **{name: getattr(bounds, name) for name in SMOOTHNESS},
    }
    criteria = [
        _criterion(name, values.get(name, getattr(straight, name, None)), bound)
        for name, bound in limits.items()
        if bound is not None
    ]
    return all(one.met for one in criteria), criteria


def judged_by_clips(whole: ClipResult, bounds: Bounds) -> tuple[bool, list[Criterion]]:
    """Whether the policy passes, and by what. whole: the episodes of all clips together."""
    criteria = [
        _criterion(name, getattr(whole, name), bound)
        for name in OF_CLIPS
        if (bound := getattr(bounds, name)) is not None
    ]
    return all(one.met for one in criteria), criteria


def metric_names(bounds: Bounds, *, of_clips: bool) -> list[str]:
    """The metrics of a job with a battery of these bounds. of_clips: its task has a reference."""
    if of_clips:
        return [
            "battery/passed",
            *(f"battery/{name}" for name in OF_CLIPS if getattr(bounds, name) is not None),
        ]
    is_judged = {"falls": True, "linear_tracking": True, "angular_tracking": True}
    is_judged |= {name: getattr(bounds, name) is not None for name in SMOOTHNESS}
    return ["battery/passed", *(f"battery/{name}" for name, judged in is_judged.items() if judged)]


def overall(commands: Sequence[CommandResult]) -> dict[Quantity, float]:
    """The share of falls, and the mean trackings, over all commands."""
    episodes = sum(row.episodes for row in commands)
    return {
        "falls": sum(row.falls for row in commands) / episodes,
        "linear_tracking": math.fsum(row.linear_tracking * row.episodes for row in commands) / episodes,
        "angular_tracking": math.fsum(row.angular_tracking * row.episodes for row in commands) / episodes,
    }


def _criterion(name: Quantity, value: float | None, bound: float) -> Criterion:
    if value is None:
        return Criterion(quantity=name, value=None, bound=bound, met=False)
    is_least = name in ("linear_tracking", "angular_tracking", "reached")
    return Criterion(
        quantity=name, value=value, bound=bound, met=value >= bound if is_least else value <= bound
    )
