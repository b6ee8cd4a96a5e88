"""What a policy is told to do, which changes within an episode."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from core.documents import Strict
from core.environments.terms.term import Array, Interval, Kinds, Term

if TYPE_CHECKING:
    from core.environments.terms.step import ModelIndex, Step


# The places of a height and a pitch in a velocity command that has them.
HEIGHT, PITCH = 3, 4


@dataclass(frozen=True)
class CommandRange:
    """One number of a command, and the range from which it is drawn."""

    name: str
    unit: str
    low: float
    high: float


class CommandTerm(Term):
    """What a policy is told: numbers that are drawn anew every `every_s`, or that follow from those."""

    noun = "command"

    every_s: float = Field(default=5.0, gt=0, le=1000, description="Seconds after which there is a new one.")

    @property
    def ranges(self) -> Sequence[CommandRange]:
        """Of its numbers, in their order."""
        raise NotImplementedError

    @property
    def num_random(self) -> int:
        """How many random numbers `drawn` takes."""
        raise NotImplementedError

    @property
    def follows(self) -> bool:
        """Whether what is told follows in each step from what was drawn, as `told` says."""
        return False

    def drawn(self, uniform: Array, step: "Step", model: "ModelIndex") -> Array:
        """The numbers of a command [n], or from what they follow [m]. uniform: [num_random] random numbers in
        [0, 1)."""
        raise NotImplementedError

    def told(self, target: Array, step: "Step", model: "ModelIndex") -> Array:
        """The command [n] after a step. target: what was drawn, [m]."""
        raise NotImplementedError


COMMANDS = Kinds(CommandTerm, "ranges", "num_random", "drawn")


class VelocityCommand(CommandTerm):
    """A velocity in the root's frame: forward and left in m/s, turn to the left in rad/s. With `height` and
    `pitch`, also how high the root is to be, in m, and how far to lean forward, in rad."""

    needs = frozenset({"free_root"})

    kind: Literal["velocity"] = "velocity"
    forward: Interval = Field(default=(-1.0, 1.0), description="[lowest, highest] in m/s.")
    left: Interval = Field(default=(-0.5, 0.5), description="[lowest, highest] in m/s.")
    turn: Interval = Field(default=(-1.0, 1.0), description="[lowest, highest] in rad/s, to the left.")
    heading: Interval | None = Field(
        default=None,
        description="[lowest, highest] in rad from the world's x to its y: where the root is to face. The "
        "turn is then `heading_stiffness` times what is missing, within `turn`. null: turns are drawn.",
    )
    heading_share: float = Field(
        default=1.0, ge=0, le=1, description="The share of commands with a heading; others have a turn."
    )
    heading_stiffness: float = Field(
        default=0.5, gt=0, le=100, description="rad/s of turn for each rad that is missing."
    )
    height: Interval | None = Field(
        default=None, description="[lowest, highest] in m above the world's origin; null: not told."
    )
    pitch: Interval | None = Field(
        default=None, description="[lowest, highest] in rad, forward; null: not told. It needs a height."
    )
    standing: float = Field(default=0.1, ge=0, le=1, description="The share of commands to stand still.")

    @model_validator(mode="after")
    def _tells_pitch_with_height(self) -> Self:
        if self.pitch is not None and self.height is None:
            raise ValueError("a command with a pitch has a height, too: give `height`, if only [0.3, 0.3]")
        return self

    @property
    def ranges(self) -> list[CommandRange]:
        """Of its numbers, in their order."""
        told = [("forward", "m/s", self.forward), ("left", "m/s", self.left), ("turn", "rad/s", self.turn)]
        more = [("height", "m", self.height), ("pitch", "rad", self.pitch)]
        return [CommandRange(name, unit, *ends) for name, unit, ends in (*told, *more) if ends is not None]

    @property
    def follows(self) -> bool:
        """Whether what is told follows in each step from what was drawn."""
        return self.heading is not None

    @property
    def num_random(self) -> int:
        """How many random numbers a command takes."""
        return len(self.ranges) + 1 + (2 if self.follows else 0)

    def drawn(self, uniform: Array, step: "Step", model: "ModelIndex") -> Array:
        """A command [n]; with a heading, that and whether it counts come after it. uniform: [num_random]
        random numbers in [0, 1)."""
        xp = step.xp
        low, high = (step.array(ends) for ends in zip(self.forward, self.left, self.turn, strict=True))
        stands = uniform[3] < self.standing
        velocity = xp.where(stands, 0.0, low + uniform[:3] * (high - low))
        rest = list[Array]()
        number = 4
        for ends in (self.height, self.pitch, self.heading):
            if ends is not None:
                rest.append(ends[0] + uniform[number] * (ends[1] - ends[0]))
                number += 1
        if self.follows:
            rest.append(xp.where(stands | (uniform[number] >= self.heading_share), 0.0, 1.0))
        return xp.concatenate([velocity, xp.stack(rest)]) if rest else velocity

    def told(self, target: Array, step: "Step", model: "ModelIndex") -> Array:
        """The command [n] after a step. target: what was drawn."""
        xp, number = step.xp, len(self.ranges)
        missing = (target[number] - model.heading(step) + xp.pi) % (2.0 * xp.pi) - xp.pi
        turn = xp.clip(self.heading_stiffness * missing, *self.turn)
        turn = xp.where(target[number + 1] > 0, turn, target[2])
        return xp.concatenate([target[:2], turn[None], target[3:number]])


class PositionCommand(CommandTerm):
    """A point on the ground to reach, told as where it lies from the root: ahead and to the left, in m."""

    needs = frozenset({"free_root"})

    kind: Literal["position"] = "position"
    x: Interval = Field(
        default=(-3.0, 3.0),
        description="[lowest, highest] in m along the world's x, from where the root is when it is drawn.",
    )
    y: Interval = Field(default=(-3.0, 3.0), description="[lowest, highest] in m along the world's y.")
    every_s: float = Field(default=8.0, gt=0, le=1000, description="Seconds after which there is a new one.")
    standing: float = Field(default=0.1, ge=0, le=1, description="The share of points where the root is.")

    @property
    def ranges(self) -> list[CommandRange]:
        """Of its numbers, in their order: no point is drawn further away."""
        furthest = max(map(abs, self.x)) + max(map(abs, self.y))
        return [CommandRange(name, "m", -furthest, furthest) for name in ("ahead", "left")]

    @property
    def num_random(self) -> int:
        return 3

    @property
    def follows(self) -> bool:
        return True

    def drawn(self, uniform: Array, step: "Step", model: "ModelIndex") -> Array:
        """A point [2] in the world, in m. uniform: [num_random] random numbers in [0, 1)."""
        low, high = (step.array(ends) for ends in zip(self.x, self.y, strict=True))
        way = step.xp.where(uniform[2] < self.standing, 0.0, low + uniform[:2] * (high - low))
        return model.position(step.after, model.root)[:2] + way

    def told(self, target: Array, step: "Step", model: "ModelIndex") -> Array:
        """Where the point [2] lies after a step: ahead of the root and to its left, [2] in m."""
        x, y = target - model.position(step.after, model.root)[:2]
        angle = model.heading(step)
        cosine, sine = step.xp.cos(angle), step.xp.sin(angle)
        return step.xp.stack([cosine * x + sine * y, cosine * y - sine * x])


AnyCommand = Annotated[VelocityCommand | PositionCommand, COMMANDS]


class EventTerm(Term):
    """What changes the body's velocities at once, every `every_s`.

    num_random: how many random numbers `drawn` takes.
    """

    noun = "event"
    num_random: ClassVar[int]

    every_s: float = Field(default=8.0, gt=0, le=1000, description="Seconds from one to the next.")

    def drawn(self, uniform: Array, step: "Step", model: "ModelIndex") -> Array:
        """The change of the velocities [nv]. uniform: [num_random] random numbers in [0, 1). step: `after` is
        what is before the change."""
        raise NotImplementedError


EVENTS = Kinds(EventTerm, "num_random", "drawn")


class Push(EventTerm):
    """An event: the root's velocity changes at once, as by a shove."""

    needs = frozenset({"free_root"})
    num_random = 3

    kind: Literal["push"] = "push"
    every_s: float = Field(default=8.0, gt=0, le=1000, description="Seconds between two pushes.")
    speed: float = Field(default=0.5, ge=0, le=20, description="Uniform in ± this along x and y, in m/s.")
    turn: float = Field(default=0.0, ge=0, le=20, description="Uniform in ± this about z, in rad/s.")

    def drawn(self, uniform: Array, step: "Step", model: "ModelIndex") -> Array:
        xp, root = step.xp, model.root_velocities
        x, y, turn = (2.0 * uniform - 1.0) * step.array((self.speed, self.speed, self.turn))
        zero = 0.0 * x
        change = xp.stack([x, y, zero, zero, zero, turn])
        return xp.concatenate([xp.zeros(root.start), change, xp.zeros(model.model.nv - root.stop)])


AnyEvent = Annotated[Push, EVENTS]


class GaitClock(Strict):
    """A phase for each foot, which goes round at this rate while the command is to move."""

    frequency: float = Field(default=1.4, gt=0, le=10, description="Steps of a foot per second.")
    offsets: Annotated[list[Annotated[float, Field(ge=0, lt=1)]], Field(min_length=1, max_length=8)] = Field(
        default=[0.0, 0.5], description="The share of a round by which each foot is ahead of the first."
    )

    def phases(self, share: Array, step: "Step") -> Array:
        """The phases [feet] in rad. share: of a round, of the first foot."""
        return 2.0 * step.xp.pi * ((share + step.array(self.offsets)) % 1.0)
