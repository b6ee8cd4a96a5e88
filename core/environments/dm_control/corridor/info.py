"""The corridor's row in the catalog, and how its options change it."""

from collections.abc import Mapping
from typing import Annotated, Any, Self

from pydantic import BeforeValidator, Field, ValidationError, model_validator

from core.documents import Strict
from core.environments.dm_control.corridor.curriculum import OF_ARENA, Curriculum
from core.environments.dm_control.corridor.options import Drawn, TaskOptions, check_stands_on_its_feet, slices
from core.environments.dm_control.corridor.walkers import (
    WALKERS,
    Arena,
    Walker,
    ZeroAction,
    check_is_offered,
)
from core.environments.info import EnvironmentInfo, Spaces, in_order, named
from core.environments.options import (
    Range,
    RunnerOptions,
    Weight,
    check_survives_its_start,
    lacks_solver,
)
from core.environments.terms.array_slices import ctrl, qpos, qvel
from core.environments.terms.inventory import inventory_of
from core.environments.terms.lent import LENT_DECODER, LentDecoder, seen_by
from core.environments.terms.task import TaskOptions as TaskOfTerms
from core.environments.terms.task import intention, parts_of
from core.physics.availability import EngineName, Rule

# The length of dm_control's first platform, and the space it leaves before the first wall, in metres.
FIRST_PLATFORM_M = 6.0
_BEFORE_THE_FIRST_WALL_M = 2.0
_MAX_OBSTACLES = 200
# How far ahead the observation reaches.
SIGHT_M = 10.0
_SEEDS = 2**32
# The walker that is also a body of the catalog, whose decoders fit.
_RODENT = "rodent"


_MANY_PAIRS = "Platforms make many pairs of geoms, and MJX checks every pair."
_ON_A_GPU = (Rule("warp", 1, _MANY_PAIRS), Rule("native", 1, _MANY_PAIRS))
# The other walkers' code has not been measured on a GPU.
_COMPILED_ON_A_GPU = {
    "ant": (Rule("compiled", 1, "Measured on an H200: 6.6 M control steps/s of physics, 1.2 M by warp."),),
    "rodent": (Rule("compiled", 1, "Measured on H200s: PPO makes 130 k control steps/s, 111 k by warp."),),
}
_ON_A_CPU = (Rule("compiled", 16, "Measured on two cores, with the ant: physics 4.2 × that of native."),)
_RODENT_ON_A_CPU = (
    Rule(
        "compiled",
        64,
        "Measured on two cores: physics 4 × that of native, after a minute in which its code is made.",
    ),
)


class _Place(Strict):
    """The walker and its arena."""

    walker: Annotated[Walker, BeforeValidator(check_is_offered)] = Field(
        "ant",
        description="One of dm_control's; `humanoid` is its CMU humanoid (2020). All but the ant and "
        "the rodent are experimental: nobody has trained them to walk.",
    )
    arena: Arena = Field("gaps", description="Platforms with gaps, walls from both sides, or neither.")
    corridor_length: float = Field(40.0, ge=8, le=400, description="Metres.")
    corridor_width: float = Field(5.0, gt=0, le=50, description="Metres.")
    platform_length: Drawn = Field((1.5, 2.0), description="`gaps`: length of each platform, in metres.")
    gap_length: Drawn = Field((0.05, 0.2), description="`gaps`: length of each gap, in metres.")
    wall_gap: Drawn = Field((5.0, 6.0), description="`walls`: from one wall to the next, in metres.")
    wall_width: Drawn = Field((1.0, 2.0), description="`walls`: how far each wall reaches in, in metres.")
    wall_height: float = Field(2.0, gt=0, le=10, description="`walls`: their height, in metres.")
    arena_seed: int = Field(
        123456, ge=0, lt=_SEEDS, description="Seed of the lengths; the job's seed has no effect on them."
    )
    num_layouts: int = Field(
        1,
        ge=1,
        le=256,
        description="How many layouts each episode takes one of; layout i has the lengths of arena_seed + i.",
    )
    curriculum: Curriculum | None = Field(
        None, description="Lengths and a target velocity that training begins with, on the way to those here."
    )
    start_x: float = Field(
        5.0, ge=0, le=400, description="The walker's initial x, in metres; the first platform ends at 6 m."
    )


class CorridorOptions(TaskOptions, RunnerOptions, _Place):  # In the schema, the last one's fields come first.
    """The walker, its arena, its reward and the physics."""

    distance_reward_weight: Weight = Field(5.0, description="Reward for each metre in +x.")
    terminate_when_unhealthy: bool = Field(
        True,
        description="false: an unhealthy step only loses the healthy reward. A fall below the ground always "
        "ends the episode.",
    )
    healthy_z_range: Range | None = Field(
        None, description="Healthy heights of the trunk, in metres; null: a range that fits the walker."
    )
    zero_action: ZeroAction | None = Field(
        None,
        description="What an action of 0 does: `middle` is a control of 0, by which a servo holds the middle "
        "of its joint's range; `start` holds the pose of the start. null: `start` for the humanoids with "
        "servos, `middle` for the others.",
    )
    action: LentDecoder = Field(None, description=f"Of the rodent. {LENT_DECODER}")
    exclude_current_positions_from_observation: bool = Field(True, description="Hide x and y.")
    num_next_obstacles: int = Field(
        0, ge=0, le=10, description="How many of the gaps or walls ahead the observation includes."
    )
    episode_length: int = Field(
        1000, ge=1, le=100_000, description="Control steps until an episode is cut off."
    )

    @property
    def healthy_range(self) -> tuple[float, float]:
        """`healthy_z_range`, or a range that fits the walker if it is null."""
        return self.healthy_z_range or WALKERS[self.walker].healthy_z_range

    @property
    def counts_from_start(self) -> bool:
        """Whether an action of 0 holds the pose of the start."""
        return (self.zero_action or WALKERS[self.walker].zero_action) == "start"

    @property
    def has_layouts(self) -> bool:
        """Whether episodes differ in their layout."""
        return self.num_layouts > 1 or self.curriculum is not None

    @model_validator(mode="after")
    def _fits(self) -> Self:
        needed = 2 * WALKERS[self.walker].reach
        if self.corridor_width < needed:
            raise ValueError(
                f"corridor_width = {self.corridor_width:g} m is too narrow: "
                f"the {self.walker} needs {needed:g} m"
            )
        room = self.corridor_length
        match self.arena:
            case "gaps":
                room = FIRST_PLATFORM_M
                _check_gaps(self)
            case "walls":
                room = self.wall_gap[0] + _BEFORE_THE_FIRST_WALL_M
                _check_walls(self, needed)
            case "empty":
                pass
        most = room - WALKERS[self.walker].reach / 2
        if self.start_x > most:
            raise ValueError(
                f"start_x = {self.start_x:g} m leaves no room to stand: at most {most:g} m fits here"
            )
        check_stands_on_its_feet(self, self.walker)
        _check_action(self)
        _check_layouts(self)
        height, terminates = WALKERS[self.walker].standing_height, self.terminate_when_unhealthy
        check_survives_its_start(height, self.healthy_range, terminates=terminates)
        return self


def _check_action(options: CorridorOptions) -> None:
    if options.action is None:
        return
    if options.walker != _RODENT:
        raise ValueError(
            f"`action` is for the walker {_RODENT!r}: no environment trains a decoder of the {options.walker}"
        )
    if options.counts_from_start:
        raise ValueError("a decoder gives the controls themselves: leave `zero_action` out")


def _check_gaps(options: CorridorOptions) -> None:
    behind = options.corridor_length - FIRST_PLATFORM_M
    if options.gap_length[1] >= behind:
        raise ValueError(
            f"gap_length goes up to {options.gap_length[1]:g} m, but behind the first platform "
            f"({FIRST_PLATFORM_M:g} m) the corridor has only {behind:g} m left"
        )
    if options.platform_length[0] <= 0:
        raise ValueError("platform_length must be above 0")
    _check_number(behind / (options.platform_length[0] + options.gap_length[0]), "platforms")


def _check_walls(options: CorridorOptions, needed: float) -> None:
    passage = options.corridor_width - options.wall_width[1]
    if passage < needed:
        raise ValueError(
            f"wall_width goes up to {options.wall_width[1]:g} m, which leaves {passage:g} m of the "
            f"corridor's {options.corridor_width:g} m to pass; the {options.walker} needs {needed:g} m"
        )
    if options.wall_gap[0] <= 0 or options.wall_width[0] <= 0:
        raise ValueError("wall_gap and wall_width must be above 0")
    _check_number(options.corridor_length / options.wall_gap[0], "walls")


def _check_layouts(options: CorridorOptions) -> None:
    if options.arena == "empty" and (options.num_layouts > 1 or options.curriculum):
        raise ValueError(
            "the arena 'empty' has nothing to lay out: num_layouts must be 1, and curriculum null"
        )
    if (last := options.arena_seed + options.num_layouts - 1) >= _SEEDS:
        raise ValueError(f"the last layout would have the seed {last}; seeds are below {_SEEDS}")
    if options.curriculum is None:
        return
    first = options.curriculum.start.given
    if unread := sorted(first.keys() - set(OF_ARENA[options.arena])):
        raise ValueError(
            f"curriculum.start has {unread[0]}, which the arena {options.arena!r} does not have; "
            f"it has {', '.join(OF_ARENA[options.arena])}"
        )
    if options.target_velocity is None and "target_velocity" in first:
        raise ValueError("curriculum.start has target_velocity, so the option itself must not be null")
    if not first:
        raise ValueError(f"curriculum.start must have {' or '.join(OF_ARENA[options.arena])}")
    try:
        type(options).model_validate({**options.model_dump(), "curriculum": None, **first})
    except ValidationError as error:
        sentence = error.errors()[0]["msg"].removeprefix("Value error, ")
        raise ValueError(f"as the curriculum begins, {sentence}") from None


def _check_number(number: float, what: str) -> None:
    if number > _MAX_OBSTACLES:
        raise ValueError(
            f"these lengths can give {number:.0f} {what}; at most {_MAX_OBSTACLES} are allowed, because "
            "each costs time at every step"
        )


def _under(options: CorridorOptions) -> Mapping[str, Any]:
    """The fields of the row that these options change."""
    walker, numbers = WALKERS[options.walker], spaces(options)
    return {
        "observation_size": numbers.observation_size,
        "action_size": numbers.action_size,
        "dt": options.timestep * options.n_frames,
        "episode_length": options.episode_length,
        "tracked_body": walker.trunk,
        "cameras": tuple(inventory_of(f"corridor/{options.walker}").cameras),
        "info": ("layout",) if options.has_layouts else (),
        "has_curriculum": options.curriculum is not None,
        "decoders_of": _RODENT if options.walker == _RODENT else None,
        "cannot_run": _cannot_run(options),
        "on_a_cpu": _RODENT_ON_A_CPU if _is_long(options) else _ON_A_CPU,
        "on_a_gpu": _COMPILED_ON_A_GPU.get(options.walker, ()) + _ON_A_GPU,
    }


def spaces(options: CorridorOptions) -> Spaces:
    """The numbers of an observation and of an action under these options."""
    own = inventory_of(f"corridor/{options.walker}")
    hidden = range(2) if options.exclude_current_positions_from_observation else ()
    ahead = [
        one
        for number in range(1, options.num_next_obstacles + 1)
        for one in (
            named(f"obstacle_{number}", ("begins ahead",), "m", None, SIGHT_M),
            named(f"obstacle_{number}", ("ends ahead",), "m", 0.0, SIGHT_M),
            named(f"obstacle_{number}", ("way past it, to the left",), "m"),
        )
    ]
    pixels = range(options.egocentric_depth)
    image = [f"row {row}, column {column}" for row in pixels for column in pixels]
    seen = [
        *qpos(own, hidden),
        *qvel(own),
        *slices(options.observables, own),
        *ahead,
        named("egocentric_depth", image, "m", 0.0, SIGHT_M),
    ]
    if options.action is None:
        return Spaces(in_order(seen), in_order(ctrl(own)))
    rat = parts_of(TaskOfTerms(), inventory_of(_RODENT))
    seen += [part for term in seen_by(options.action) for part in term.slices_of_history(rat)]
    return Spaces(in_order(seen), in_order(intention(options.action)))


def _is_long(options: CorridorOptions) -> bool:
    """Whether the body compiles into 600,000 operations a substep and more."""
    return options.walker == "rodent" and options.arena != "empty"


def _cannot_run(options: CorridorOptions) -> Mapping[EngineName, str]:
    cannot = dict(lacks_solver(options))
    if WALKERS[options.walker].has_ellipsoids and options.arena != "empty":
        cannot["mjx"] = (
            f"MJX has no contacts between ellipsoids and boxes: the {options.walker} has ellipsoids, and "
            f"the arena {options.arena!r} has boxes. Choose native or warp, or the arena 'empty'."
        )
    if WALKERS[options.walker].has_cylinders and options.arena != "empty":
        cannot["mjx"] = (
            f"MJX has no contacts between cylinders and boxes: the head of the {options.walker} is a "
            f"cylinder, and the arena {options.arena!r} has boxes. Choose native or warp, or the arena "
            "'empty'."
        )
    return cannot


INFO = EnvironmentInfo(
    id="corridor",
    description="dm_control's ant, rodent, humanoids or balls, rewarded for running in +x in a corridor "
    "with gaps or walls.",
    factory="core.environments.dm_control.corridor.environment:make",
    package="dm_control",
    options=CorridorOptions,
    # A policy that is older than `zero_action` needs "middle".
    free_in_rollouts=(*(name for name in _Place.model_fields if name != "walker"), "zero_action"),
    vary=_under,
    slices=spaces,
    **_under(CorridorOptions.model_validate({})),
)
