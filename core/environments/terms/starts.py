"""Where and how an episode begins: random ranges of the root and of joints, and bodies that have fallen.

The names of the ranges are those of Isaac Lab's and mjlab's `reset_root_state_uniform`.
"""

from typing import ClassVar

from pydantic import Field

from core.documents import Strict
from core.environments.terms.term import Interval

_NONE = (0.0, 0.0)


class _RootRange(Strict):
    """A range for each of the root's six freedoms."""

    num_random: ClassVar[int] = 6

    @property
    def ranges(self) -> list[tuple[float, float]]:
        """[6, 2]"""
        return [getattr(self, name) for name in ("x", "y", "z", "roll", "pitch", "yaw")]


class PoseRange(_RootRange):
    """How the root begins, from where it is in the pose: moved along the world's axes, and turned about them,
    by roll first and by yaw last. Each is uniform in [lowest, highest]."""

    x: Interval = Field(default=_NONE, description="In m.")
    y: Interval = Field(default=_NONE, description="In m.")
    z: Interval = Field(default=_NONE, description="In m.")
    roll: Interval = Field(default=_NONE, description="In rad about the world's x.")
    pitch: Interval = Field(default=_NONE, description="In rad about the world's y.")
    yaw: Interval = Field(default=_NONE, description="In rad about the world's z.")


class VelocityRange(_RootRange):
    """What is added to the root's velocity at the start. Each is uniform in [lowest, highest]."""

    x: Interval = Field(default=_NONE, description="In m/s along the world's x.")
    y: Interval = Field(default=_NONE, description="In m/s along the world's y.")
    z: Interval = Field(default=_NONE, description="In m/s along the world's z.")
    roll: Interval = Field(default=_NONE, description="In rad/s about the root's x.")
    pitch: Interval = Field(default=_NONE, description="In rad/s about the root's y.")
    yaw: Interval = Field(default=_NONE, description="In rad/s about the root's z.")


class Fallen(Strict):
    """A share of the episodes begins as after a fall: the root turned at random, dropped, limbs anywhere."""

    num_random: ClassVar[int] = 4

    share: float = Field(default=1.0, gt=0, le=1, description="The share of such episodes.")
    upside_down: bool = Field(
        default=False,
        description="Turn the pose by half a turn about the root's x, then at random about the world's z; "
        "otherwise at random about all axes.",
    )
    height: Interval | None = Field(
        default=None,
        description="[lowest, highest] in m: from where the root is dropped, above the ground; null: so high "
        "that no geom of the pose would be below the ground, however it is turned.",
    )
    joints: float = Field(
        default=1.0,
        ge=0,
        le=1,
        description="Joints are uniform in this share of their ranges, around their middles; 0: in the pose.",
    )
