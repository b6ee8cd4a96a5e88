"""Facts about the walkers that need no loading; the numbers were read from the composed models."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

Walker = Literal["ant", "rodent", "humanoid"]
Arena = Literal["empty", "gaps", "walls"]


@dataclass(frozen=True)
class WalkerInfo:
    """One of dm_control's walkers.

    source: `module:class` of dm_control. trunk: the body whose height counts and which the camera follows.
    num_positions, num_velocities: nq and nv, the free joint included. reach: metres from the trunk to the
    farthest tip when it stands. standing_height, healthy_z_range: height of the trunk above the ground, in
    metres; docs/environments/corridor.md has the measurements. settles: whether it stands without control.
    has_ellipsoids: whether parts that touch the arena are ellipsoids. cameras: in their order.
    """

    source: str
    trunk: str
    num_positions: int
    num_velocities: int
    num_actuators: int
    reach: float
    standing_height: float
    healthy_z_range: tuple[float, float]
    settles: bool
    has_ellipsoids: bool
    cameras: tuple[str, ...]


WALKERS: Mapping[Walker, WalkerInfo] = {
    "ant": WalkerInfo(
        source="dm_control.locomotion.walkers.ant:Ant",
        trunk="walker/torso",
        num_positions=15,
        num_velocities=14,
        num_actuators=8,
        reach=1.0,
        standing_height=0.36,
        healthy_z_range=(0.27, 1.0),
        settles=True,
        has_ellipsoids=False,
        cameras=("walker/sideon", "walker/float_far", "walker/floating", "walker/egocentric"),
    ),
    "rodent": WalkerInfo(
        source="dm_control.locomotion.walkers.rodent:Rat",
        trunk="walker/torso",
        num_positions=74,
        num_velocities=73,
        num_actuators=38,
        reach=0.3,
        standing_height=0.047,
        healthy_z_range=(0.03, 0.3),
        settles=True,
        has_ellipsoids=True,
        cameras=("walker/back", "walker/side", "walker/side_alt", "walker/top", "walker/egocentric"),
    ),
    "humanoid": WalkerInfo(
        source="dm_control.locomotion.walkers.cmu_humanoid:CMUHumanoidPositionControlledV2020",
        trunk="walker/root",
        num_positions=63,
        num_velocities=62,
        num_actuators=56,
        reach=1.0,
        standing_height=1.14,
        healthy_z_range=(0.7, 1.5),
        settles=False,
        has_ellipsoids=True,
        cameras=(
            "walker/back",
            "walker/side",
            "walker/front_side",
            "walker/bodycam",
            "walker/egocentric",
        ),
    ),
}
