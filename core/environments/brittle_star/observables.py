"""What a brittle star may observe, by biorobot's names."""

from typing import Literal, get_args

BodyObservable = Literal[
    "joint_position",
    "joint_velocity",
    "joint_actuator_force",
    "actuator_force",
    "disk_position",
    "disk_rotation",
    "disk_linear_velocity",
    "disk_angular_velocity",
    "segment_contact",
]
TargetObservable = Literal["unit_xy_direction_to_target", "xy_distance_to_target"]
LightObservable = Literal["segment_light_intake", "disk_light_intake"]
Observable = BodyObservable | TargetObservable | LightObservable

BODY_OBSERVABLES: tuple[BodyObservable, ...] = get_args(BodyObservable)
TARGET_OBSERVABLES: tuple[TargetObservable, ...] = get_args(TargetObservable)
# What a State's `info` holds about the target.
OF_THE_WAY = ("target_position", "xy_direction_to_target", "xy_distance_to_target")
LIGHT_OBSERVABLES: tuple[LightObservable, ...] = get_args(LightObservable)
# Engines compute these only for the observation.
COSTLY_OBSERVABLES: tuple[BodyObservable, ...] = ("joint_actuator_force", "actuator_force", "segment_contact")


def size_of(observable: Observable, num_segments: int) -> int:
    """How many numbers the observable has; num_segments: of all arms together."""
    match observable:
        case "joint_position" | "joint_velocity" | "joint_actuator_force" | "actuator_force":
            return 2 * num_segments
        case "segment_contact" | "segment_light_intake":
            return num_segments
        case "unit_xy_direction_to_target":
            return 2
        case "xy_distance_to_target" | "disk_light_intake":
            return 1
        case "disk_position" | "disk_rotation" | "disk_linear_velocity" | "disk_angular_velocity":
            return 3
