"""Facts about the walkers that need no loading; the numbers were read from the composed models."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

Walker = Literal[
    "ant",
    "rodent",
    "humanoid",
    "humanoid_2019",
    "humanoid_2019_torque",
    "jumping_ball",
    "rolling_ball",
]
Arena = Literal["empty", "gaps", "walls"]
ZeroAction = Literal["middle", "start"]


@dataclass(frozen=True)
class WalkerInfo:
    """One of dm_control's walkers.

    source: `module:class` of dm_control. trunk: the body whose height counts and which the camera follows.
    reach: metres from the trunk to the farthest tip when it stands. standing_height,
    healthy_z_range: height of the trunk above the ground, in metres; docs/environments/corridor.md has the
    measurements. settles: whether it stands without control. zero_action: the default of the
    option of this name. has_ellipsoids, has_cylinders: whether parts that touch the arena are. feet: bodies;
    their geoms, and those of all that they carry, are dm_control's `ground_contact_geoms`. end_effectors:
    dm_control's, which are bodies.
    """

    source: str
    trunk: str
    reach: float
    standing_height: float
    healthy_z_range: tuple[float, float]
    settles: bool
    has_ellipsoids: bool
    feet: tuple[str, ...]
    end_effectors: tuple[str, ...]
    has_cylinders: bool = False
    zero_action: ZeroAction = "middle"


_ANT_FEET = (
    "walker/front_left_foot",
    "walker/front_right_foot",
    "walker/back_right_foot",
    "walker/back_left_foot",
)
_HUMANOID_END_EFFECTORS = ("walker/rradius", "walker/lradius", "walker/rfoot", "walker/lfoot")

_HUMANOID_2019 = WalkerInfo(
    source="dm_control.locomotion.walkers.cmu_humanoid:CMUHumanoidPositionControlled",
    trunk="walker/root",
    reach=1.0,
    standing_height=0.94,
    healthy_z_range=(0.6, 1.25),
    settles=False,
    has_ellipsoids=True,
    feet=("walker/lfoot", "walker/rfoot"),
    end_effectors=_HUMANOID_END_EFFECTORS,
    zero_action="start",
)

_JUMPING_BALL = WalkerInfo(
    source="dm_control.locomotion.walkers.jumping_ball:JumpingBallWithHead",
    trunk="walker/head_body",
    reach=0.3,
    standing_height=0.6,
    healthy_z_range=(0.4, 3.0),
    settles=True,
    has_ellipsoids=False,
    has_cylinders=True,
    feet=("walker/torso",),
    end_effectors=("walker/head_body",),
)

WALKERS: Mapping[Walker, WalkerInfo] = {
    "ant": WalkerInfo(
        source="dm_control.locomotion.walkers.ant:Ant",
        trunk="walker/torso",
        reach=1.0,
        standing_height=0.36,
        healthy_z_range=(0.27, 1.0),
        settles=True,
        has_ellipsoids=False,
        feet=_ANT_FEET,
        end_effectors=_ANT_FEET,
    ),
    "rodent": WalkerInfo(
        source="dm_control.locomotion.walkers.rodent:Rat",
        trunk="walker/torso",
        reach=0.3,
        standing_height=0.047,
        healthy_z_range=(0.03, 0.3),
        settles=True,
        has_ellipsoids=True,
        # The last one is where its tail begins.
        feet=("walker/foot_L", "walker/foot_R", "walker/hand_L", "walker/hand_R", "walker/vertebra_C1"),
        end_effectors=("walker/lower_arm_R", "walker/lower_arm_L", "walker/foot_R", "walker/foot_L"),
    ),
    "humanoid": WalkerInfo(
        source="dm_control.locomotion.walkers.cmu_humanoid:CMUHumanoidPositionControlledV2020",
        trunk="walker/root",
        reach=1.0,
        standing_height=1.14,
        healthy_z_range=(0.7, 1.5),
        settles=False,
        has_ellipsoids=True,
        feet=("walker/lfoot", "walker/rfoot"),
        end_effectors=_HUMANOID_END_EFFECTORS,
        zero_action="start",
    ),
    "humanoid_2019": _HUMANOID_2019,
    "humanoid_2019_torque": replace(
        _HUMANOID_2019,
        source="dm_control.locomotion.walkers.cmu_humanoid:CMUHumanoid",
        zero_action="middle",
    ),
    "jumping_ball": _JUMPING_BALL,
    "rolling_ball": replace(
        _JUMPING_BALL,
        source="dm_control.locomotion.walkers.jumping_ball:RollingBallWithHead",
        healthy_z_range=(0.4, 1.0),
    ),
}

NOT_OFFERED: Mapping[str, str] = {
    "fruitfly": "dm_control measures it in centimetres and grams and steps it every 0.0001 s; corridors are "
    "in metres",
    "dog": "dm_control has files of it, but no walker",
    "box_head": "it is soccer's player, which moves like `jumping_ball`",
    "soccer_humanoid": "it is soccer's player, which moves like `humanoid_2019`",
}
"""Other bodies of dm_control's that one might ask for, and why no corridor has them."""


def check_is_offered(walker: object) -> object:
    """The same value. Raises ValueError where dm_control has such a walker and corridors do not."""
    if isinstance(walker, str) and (reason := NOT_OFFERED.get(walker)):
        raise ValueError(f"{walker!r} cannot run in a corridor: {reason}. Choose from {', '.join(WALKERS)}")
    return walker
