"""What a policy is told to do, which changes within an episode."""

from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from pydantic import Field

from core.documents import Strict
from core.environments.terms.term import Array, Interval

if TYPE_CHECKING:
    from core.environments.terms.step import Step


class VelocityCommand(Strict):
    """A velocity in the root's frame: forward and left in m/s, turn to the left in rad/s."""

    num_random: ClassVar[int] = 4

    kind: Literal["velocity"] = "velocity"
    forward: Interval = Field(default=(-1.0, 1.0), description="[lowest, highest] in m/s.")
    left: Interval = Field(default=(-0.5, 0.5), description="[lowest, highest] in m/s.")
    turn: Interval = Field(default=(-1.0, 1.0), description="[lowest, highest] in rad/s, to the left.")
    every_s: float = Field(default=5.0, gt=0, le=1000, description="Seconds after which there is a new one.")
    standing: float = Field(default=0.1, ge=0, le=1, description="The share of commands to stand still.")

    def drawn(self, uniform: Array, step: "Step") -> Array:
        """A command [3]. uniform: [num_random] random numbers in [0, 1)."""
        low, high = (step.array(ends) for ends in zip(self.forward, self.left, self.turn, strict=True))
        return step.xp.where(uniform[3] < self.standing, 0.0, low + uniform[:3] * (high - low))


class Push(Strict):
    """An event: the root's velocity changes at once, as by a shove."""

    num_random: ClassVar[int] = 3

    kind: Literal["push"] = "push"
    every_s: float = Field(default=8.0, gt=0, le=1000, description="Seconds between two pushes.")
    speed: float = Field(default=0.5, ge=0, le=20, description="Uniform in ± this along x and y, in m/s.")
    turn: float = Field(default=0.0, ge=0, le=20, description="Uniform in ± this about z, in rad/s.")

    def drawn(self, uniform: Array, step: "Step") -> Array:
        """The change of the root's velocity [6]. uniform: [num_random] random numbers in [0, 1)."""
        x, y, turn = (2.0 * uniform - 1.0) * step.array((self.speed, self.speed, self.turn))
        zero = 0.0 * x
        return step.xp.stack([x, y, zero, zero, zero, turn])


class GaitClock(Strict):
    """A phase for each foot, which goes round at this rate while the command is to move."""

    frequency: float = Field(default=1.4, gt=0, le=10, description="Steps of a foot per second.")
    offsets: Annotated[list[Annotated[float, Field(ge=0, lt=1)]], Field(min_length=1, max_length=8)] = Field(
        default=[0.0, 0.5], description="The share of a round by which each foot is ahead of the first."
    )

    def phases(self, share: Array, step: "Step") -> Array:
        """The phases [feet] in rad. share: of a round, of the first foot."""
        return 2.0 * step.xp.pi * ((share + step.array(self.offsets)) % 1.0)
