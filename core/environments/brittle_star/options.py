"""A job's options for a brittle star: its body, its arena, its task."""

import math
from collections.abc import Mapping
from typing import Annotated, Literal, Self, get_args

from pydantic import Field, field_validator, model_validator

from core.bounds import Real
from core.documents import Strict
from core.environments.cpg.options import CPGOptions
from core.environments.options import (
    LINE_SEARCH_ITERATIONS,
    SOLVER_ITERATIONS,
    NoiseScale,
    SolverIterations,
)

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
# A State's `info` holds these about the target.
OF_THE_WAY = ("target_position", "xy_direction_to_target", "xy_distance_to_target")
LIGHT_OBSERVABLES: tuple[LightObservable, ...] = get_args(LightObservable)
# Engines compute these only for the observation.
COSTLY_OBSERVABLES: tuple[BodyObservable, ...] = ("joint_actuator_force", "actuator_force", "segment_contact")


# biorobot puts its morphology's name before the names of all its parts.
DISK = "BrittleStarMorphology/central_disk"
TARGET_RADIUS_M = 0.2
DISK_RADIUS_M = 0.125
# Pixels of the ground plane's texture per metre of the arena's half lengths.
LIGHT_MAP_RESOLUTION = 50
_TIMESTEP_S = 0.002
_FIRST_SEGMENT_M, _TAPER_M = 0.125, 0.075
_MAX_STEPS = 100_000
_MAX_SEGMENTS = 96
_Metres = Annotated[int, Field(ge=1, le=50)]
_Point = Annotated[tuple[Real, Real], Field(strict=False)]
# Some more than the checks allow, whose sentences say why.
_Segments = Annotated[int, Field(ge=-_MAX_STEPS, le=_MAX_STEPS)]
_OBSERVED = "Observables to include. null: all; with `cpg`, all but the costly forces and contacts."


class BrittleStarOptions(Strict):
    """The body, the arena, the physics and the observation: the same for all tasks."""

    num_arms: int = Field(5, ge=3, le=8, description="Arms, evenly around the disk.")
    num_segments_per_arm: _Segments | Annotated[list[_Segments], Field(max_length=64)] = Field(
        5, description="Segments of every arm, or a list with those of each arm; 0 leaves an arm out."
    )
    actuation: Literal["p_control", "torque_control"] = Field(
        "p_control", description="What an action sets at a joint: a servo's target angle, or a torque."
    )
    control: Literal["joints", "cpg"] = Field(
        "joints",
        description="What an action is: the joints' angles or torques, or the parameters of a central "
        "pattern generator that moves them.",
    )
    cpg: CPGOptions = Field(
        CPGOptions.model_validate({}), description="The pattern generator, with `control` = `cpg`."
    )
    arena_size: Annotated[tuple[_Metres, _Metres], Field(strict=False)] = Field(
        (10, 5), description="Half lengths in x and y, in metres."
    )
    walls: Literal["bound", "contacts"] = Field(
        "bound",
        description="`contacts`: every segment collides with the walls, as in biorobot. `bound`: only the "
        "disk stops at them, at almost no cost; arms reach through.",
    )
    random_initial_rotation: bool = Field(
        False, description="Start each episode with a random rotation about the vertical."
    )
    joint_randomization_noise_scale: NoiseScale = Field(
        0.01,
        description="Noise on the joints' initial positions and velocities, uniform in ± this: rad, rad/s.",
    )
    num_physics_steps_per_control_step: int = Field(10, ge=1, le=100)
    time_scale: float = Field(2.0, ge=0.25, le=5, description="A physics step takes this times 2 ms.")
    simulation_time: float = Field(20.0, gt=0, le=4000, description="Seconds until an episode is cut off.")
    iterations: SolverIterations = Field(None, ge=1, le=100, description=SOLVER_ITERATIONS)
    ls_iterations: SolverIterations = Field(None, ge=1, le=100, description=LINE_SEARCH_ITERATIONS)

    @property
    def segments(self) -> list[int]:
        """The number of segments of each arm, [num_arms]."""
        counts = self.num_segments_per_arm
        return [counts] * self.num_arms if isinstance(counts, int) else counts

    @property
    def timestep(self) -> float:
        """Seconds per physics step."""
        return _TIMESTEP_S * self.time_scale

    @property
    def dt(self) -> float:
        """Seconds per control step."""
        return self.timestep * self.num_physics_steps_per_control_step

    @property
    def episode_length(self) -> int:
        """Control steps that fill the simulation time, free of the quotient's rounding error."""
        return math.ceil(round(self.simulation_time / self.dt, 6))

    @property
    def start_x(self) -> float:
        """The disk's initial x, in metres."""
        return 0.0

    @property
    def reach(self) -> float:
        """Metres from the disk's centre to the tip of the longest arm."""
        return DISK_RADIUS_M + max(
            sum(_FIRST_SEGMENT_M - _TAPER_M * index / number for index in range(number)) if number else 0.0
            for number in self.segments
        )

    @field_validator("num_segments_per_arm")
    @classmethod
    def _is_an_arm(cls, value: int | list[int]) -> int | list[int]:
        counts = [value] if isinstance(value, int) else value
        if min(counts, default=0) < 0:
            raise ValueError("must not be negative")
        if sum(counts) == 0:
            raise ValueError("there must be at least one segment: a disk alone cannot move")
        return value

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if len(self.segments) != self.num_arms:
            raise ValueError(
                f"num_segments_per_arm lists {len(self.segments)} arms, but num_arms = {self.num_arms}"
            )
        if (total := sum(self.segments)) > _MAX_SEGMENTS:
            raise ValueError(
                f"the arms have {total} segments; at most {_MAX_SEGMENTS} are allowed: with more the model "
                "does not compile in time"
            )
        if self.episode_length > _MAX_STEPS:
            raise ValueError(
                f"simulation_time = {self.simulation_time:g} s is {self.episode_length} control steps of "
                f"{self.dt:g} s; at most {_MAX_STEPS} are allowed"
            )
        if self.control == "cpg":
            self.cpg.check_steps(self.dt)
        room = min(self.arena_size[0] - abs(self.start_x), self.arena_size[1])
        if room < self.reach:
            raise ValueError(
                f"arena_size = {list(self.arena_size)} leaves {room:g} m around the disk's initial position, "
                f"but the arms reach {self.reach:.2f} m"
            )
        return self


class DirectedOptions(BrittleStarOptions):
    """A brittle star, its arena, and the target that it should reach."""

    target_position: _Point | None = Field(
        None, description="x and y in metres; null: drawn for each episode, at `target_distance`."
    )
    target_distance: float = Field(
        3.0, gt=0, le=100, description="Metres from the middle of the arena; the direction is drawn."
    )
    observables: list[BodyObservable | TargetObservable] | None = Field(
        None, min_length=1, max_length=64, description=_OBSERVED
    )

    @model_validator(mode="after")
    def _target_fits(self) -> Self:
        if self.target_position is None:
            distance, nearest = self.target_distance, min(self.arena_size)
            if distance > nearest:
                raise ValueError(
                    f"target_distance = {distance:g} m is beyond the arena's nearest wall, at {nearest:g} m"
                )
        else:
            distance = math.hypot(*self.target_position)
            if any(abs(x) > size for x, size in zip(self.target_position, self.arena_size, strict=True)):
                raise ValueError(
                    f"target_position = {list(self.target_position)} is outside the arena, "
                    f"± {list(self.arena_size)} m"
                )
        if distance < TARGET_RADIUS_M:
            raise ValueError(
                f"the target is {distance:g} m from the star's initial position, and within "
                f"{TARGET_RADIUS_M:g} m it counts as reached"
            )
        return self


class UndirectedOptions(BrittleStarOptions):
    """A brittle star and its arena."""

    observables: list[BodyObservable] | None = Field(None, min_length=1, max_length=64, description=_OBSERVED)


class LightEscapeOptions(BrittleStarOptions):
    """A brittle star, its arena, and the light that it should escape."""

    light_perlin_noise_scale: int = Field(
        0, ge=0, le=200, description="Patches of light and shadow along each side of the arena; 0: none."
    )
    light_seed: int = Field(
        0, ge=0, lt=2**32, description="Seed of the patches; the job's has no effect on them."
    )
    observables: list[BodyObservable | LightObservable] | None = Field(
        None, min_length=1, max_length=64, description=_OBSERVED
    )

    @property
    def start_x(self) -> float:
        return -0.75 * self.arena_size[0]

    @model_validator(mode="after")
    def _patches_fit(self) -> Self:
        pixels = [LIGHT_MAP_RESOLUTION * size for size in self.arena_size]
        scale = self.light_perlin_noise_scale
        if scale and any(side % scale for side in pixels):
            raise ValueError(
                f"light_perlin_noise_scale = {scale} does not divide the light map of this arena, "
                f"{pixels[0]} × {pixels[1]} pixels"
            )
        return self


Options = DirectedOptions | UndirectedOptions | LightEscapeOptions


def observed(options: Options) -> list[Observable]:
    """The names of the observables, in biorobot's order."""
    of_the_task: Mapping[type[Options], tuple[Observable, ...]] = {
        DirectedOptions: TARGET_OBSERVABLES,
        UndirectedOptions: (),
        LightEscapeOptions: LIGHT_OBSERVABLES,
    }
    every = (*BODY_OBSERVABLES, *of_the_task[type(options)])
    if options.observables is not None:
        return [name for name in every if name in options.observables]
    return [name for name in every if options.control == "joints" or name not in COSTLY_OBSERVABLES]
