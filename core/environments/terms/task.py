"""A task: the terms of an environment, how its episodes begin, and how its physics is stepped."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from core.bounds import MOST_ITEMS, Real
from core.documents import Strict
from core.environments.info import CRITIC_GROUP, POLICY_GROUP, Slice, Spaces, in_order, named
from core.environments.options import NoiseScale
from core.environments.terms.actions import (
    ActionTerm,
    AnyAction,
    ControlAction,
    DecoderAction,
    JointAction,
    of_the_body,
)
from core.environments.terms.commands import (
    AnyCommand,
    AnyEvent,
    GaitClock,
    PositionCommand,
    VelocityCommand,
)
from core.environments.terms.inventory import Actuator, Inventory, ModelParts
from core.environments.terms.metrics import (
    AnyMetric,
    DistanceFromStart,
    FollowedCommand,
    FollowedPosition,
    FollowedReference,
    Travel,
)
from core.environments.terms.observations import ObservationTerm, Qpos, Qvel, Sensors
from core.environments.terms.readings import Reading
from core.environments.terms.reference import Adaptive, Reference, compared_bodies
from core.environments.terms.starts import Fallen, PoseRange, VelocityRange
from core.environments.terms.term import Memory, Name, Term
from core.environments.terms.terminations import AnyTermination
from core.environments.terms.terrain import Terrain
from core.environments.terms.vocabulary import AnyCriticObservation, AnyObservation, AnyReward
from core.patterns import PATTERNS, Pattern, matching_in_turn
from core.physics.availability import EngineName, beyond

MOST_FEET = 8
_SECONDS_PER_ACTION = 0.02
# Seconds per physics step.
SHORTEST_STEP_S, LONGEST_STEP_S = 1e-5, 0.1

Rewards = Annotated[list[AnyReward], Field(min_length=1, max_length=64)] | None
Observations = Annotated[list[AnyObservation], Field(min_length=1, max_length=64)] | None
Critic = Annotated[list[AnyCriticObservation], Field(min_length=1, max_length=64)] | None
Terminations = Annotated[list[AnyTermination], Field(max_length=64)] | None
Metrics = Annotated[list[AnyMetric], Field(max_length=16)] | None
Feet = Annotated[list[Pattern], Field(max_length=MOST_FEET)]
Events = Annotated[list[AnyEvent], Field(max_length=16)]


class Reset(Strict):
    """How an episode begins; by default in the model's initial state with a little noise."""

    keyframe: Name | Annotated[int, Field(ge=0, le=MOST_ITEMS)] | None = Field(
        default=None,
        description="By name or number: its positions, velocities and states of actuators. null: the "
        "model's custom numeric `init_qpos`, or else `qpos0`.",
    )
    qpos: Annotated[list[Real], Field(min_length=1, max_length=MOST_ITEMS)] | None = Field(
        default=None, description="Initial positions, in MuJoCo's order."
    )
    lift: NoiseScale = Field(
        default=0.0, description="How much higher a root with a free joint begins, in m."
    )
    position_noise: NoiseScale = Field(default=0.01, description="Uniform in ± this: m, rad.")
    velocity_noise: NoiseScale = Field(default=0.01, description="See velocity_distribution: m/s, rad/s.")
    velocity_distribution: Literal["uniform", "normal"] = Field(
        default="uniform", description="Uniform in ± velocity_noise, or normal with that standard deviation."
    )

    joints: float | None = Field(
        default=None,
        ge=0,
        le=1,
        description="Joints with a range begin uniform in this share of it, about its middle; null: posed.",
    )
    pose: PoseRange | None = Field(default=None, description="Random ranges of the root's pose.")
    velocity: VelocityRange | None = Field(default=None, description="Random ranges of the root's velocity.")
    fallen: Fallen | None = Field(default=None, description="Episodes that begin as after a fall.")

    @property
    def moves_root(self) -> bool:
        """Whether the root begins elsewhere than noise puts it."""
        return any(part is not None for part in (self.pose, self.velocity, self.fallen))

    @model_validator(mode="after")
    def _begins_once(self) -> Self:
        if self.keyframe is not None and self.qpos is not None:
            raise ValueError("give either keyframe or qpos")
        return self


class TaskOptions(Strict):
    """What a body is to do, in terms."""

    root: Name | None = Field(
        default=None,
        description="Body of the terms that name no body; null: the first body that can travel, of those "
        "with actuators.",
    )
    reward: Rewards = Field(
        default=None,
        description="Terms to sum; null: forward_velocity, alive, and control_cost of weight 0.05.",
    )
    observation: Observations = Field(
        default=None, description="Terms to concatenate, in this order; null: qpos and qvel."
    )
    critic: Critic = Field(
        default=None,
        description="Terms that the value function sees in place of the observation, without noise; they "
        "include all of the observation's. null: it sees the observation.",
    )
    termination: Terminations = Field(
        default=None,
        description="Terms, any of which ends the episode; null: for a body that can travel, height_range "
        "from 0.4 to 2 times its initial height.",
    )
    metrics: Metrics = Field(
        default=None,
        description="What each step reports besides the reward's terms; null: the root's travel, its "
        "distance from the start, and how far it is from the command.",
    )
    action: AnyAction = Field(default=ControlAction(), description="How an action becomes controls.")
    command: AnyCommand | None = Field(
        default=None, description="What the policy is told to do; null: nothing."
    )
    feet: Feet = Field(default=[], description=f"The bodies that are feet, in the gait's order. {PATTERNS}")
    gait: GaitClock | None = Field(
        default=None, description="The clock of the terms `gait_phase` and `swing_height`."
    )
    events: Events = Field(default=[], description="What happens to the body within an episode.")
    reset: Reset = Reset()
    terrain: Terrain | None = Field(
        default=None,
        description="Uneven ground, another in each episode; null: the model's own ground alone.",
    )
    reference: Reference | None = Field(
        default=None, description="What the body follows: clips of its motion; null: nothing."
    )
    n_frames: int | None = Field(
        default=None, ge=1, le=1000, description="Physics steps per action; null: as many as fill 0.02 s."
    )
    timestep: float | None = Field(
        default=None,
        ge=SHORTEST_STEP_S,
        le=LONGEST_STEP_S,
        description="Seconds per physics step; null: the model's.",
    )
    solver: Literal["newton", "cg"] = Field(
        default="newton",
        description="Constraint solver on mjx and warp; compiled has Newton's, native keeps the model's.",
    )
    iterations: int = Field(
        default=4, ge=1, le=100, description="Solver iterations on mjx, warp and compiled."
    )
    ls_iterations: int = Field(
        default=8, ge=1, le=100, description="Line-search iterations on mjx, warp and compiled."
    )
    nconmax: int | None = Field(
        default=None,
        ge=1,
        le=1024,
        description="Room for contacts of a body at once on compiled; null: twice as many as it has in a "
        "short simulation.",
    )

    @model_validator(mode="after")
    def _has_a_metric_for_each_term(self) -> Self:
        names = metric_names(self.reward or [])
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"two reward terms are called {', '.join(twice)}: give them a `name` each")
        return self

    @property
    def terms(self) -> list[Term]:
        """All that it gives."""
        seen = (*(self.observation or ()), *(self.critic or ()))
        return [*(self.reward or ()), *seen, *(self.termination or ()), *reported(self)]

    def readings(self, model: Inventory) -> list[Reading]:
        """What the terms read of contacts. model: of the body."""
        parts = parts_of(self, model)
        return list(dict.fromkeys(reading for term in self.terms for reading in term.readings(parts)))

    @property
    def memory(self) -> frozenset[Memory]:
        """What is carried from step to step; for tasks that name no metrics always the previous action, which
        their checkpoints hold."""
        always: tuple[Memory, ...] = ("previous_action",) if self.metrics is None else ()
        return frozenset[Memory](always).union(*(part.remembers for part in self._parts))

    @property
    def cannot_run(self) -> Mapping[EngineName, str]:
        """Engines that cannot read what the terms read, and why."""
        return {engine: beyond(engine, why) for part in self._parts for engine, why in part.beyond.items()}

    @property
    def _parts(self) -> list[Term]:
        return [part for term in self.terms for part in (term, *term.inner)]

    @property
    def sensors(self) -> list[str] | None:
        """The model's own sensors that some term reads; None: all."""
        seen = [*(self.observation or []), *(self.critic or [])]
        terms = [term for term in seen if isinstance(term, Sensors)]
        if any(term.names is None for term in terms):
            return None
        return [name for term in terms for name in term.names or []]


def metric_names(terms: Sequence[AnyReward]) -> list[str]:
    """The metric of each term: `reward_`, then its name or its kind, without a plugin's name before it."""
    return [f"reward_{term.name or term.kind.rpartition('/')[2]}" for term in terms]


def task_slices(options: TaskOptions, model: Inventory, unit_of_action: str | None = None) -> Spaces:
    """The numbers of the observations and of the action. model: of the body."""
    parts = parts_of(options, model)
    seen, by_critic = (
        [part for term in terms for part in term.slices_of_history(parts)]
        for terms in (observed(options), options.critic or ())
    )
    if isinstance(options.action, DecoderAction):
        acts = intention(options.action)
    else:
        acts = [
            named(name, (name,), unit_of_action, *_ends(options, actuator))
            for name, actuator in acting(options, model)
        ]
    return Spaces(in_order(seen), in_order(acts), in_order(by_critic))


def intention(action: DecoderAction) -> list[Slice]:
    """Its numbers; none before the action is filled in."""
    names = (f"intention {number}" for number in range(action.latent or 0))
    return [named("intention", names, "1", -action.reach, action.reach)]


def acting(options: TaskOptions, model: Inventory) -> Sequence[tuple[str, Actuator | None]]:
    """The names of the numbers of the body's action, each with the actuator that it moves; None: it is no
    actuator's."""
    action = of_the_body(options.action)
    if isinstance(action, ActionTerm):
        return [(name, None) for name in action.names(model)]
    named = list(zip(model.acting, model.actuators, strict=True))
    if not isinstance(action, JointAction):
        return named
    return [one for one in named if any(part.drives(one[1].joint or "") for part in action.parts)]


def varied(options: TaskOptions) -> Mapping[str, Any]:
    """What these options change of the catalog's row."""
    return {
        "observations": (POLICY_GROUP, *([CRITIC_GROUP] if options.critic else [])),
        "cannot_run": options.cannot_run,
        **curriculum(options),
    }


def curriculum(options: TaskOptions) -> Mapping[str, Any]:
    """Whether fresh starts change while a run trains, and by which option."""
    if options.reference is not None and isinstance(options.reference.sampling, Adaptive):
        return {"has_curriculum": True, "curriculum_option": "reference/sampling"}
    return {"has_curriculum": options.terrain is not None and options.terrain.has_curriculum}


def _ends(options: TaskOptions, actuator: Actuator | None) -> tuple[float | None, float | None]:
    """The controls that -1 and 1 set; those of servos are not known before the model is read."""
    if not isinstance(options.action, ControlAction):
        return None, None
    if not options.action.scaled:
        return -1.0, 1.0
    return (actuator and actuator.control_range) or (
        -1.0,
        1.0,
    )  # Without a range, an action is the control itself.


def num_substeps(options: TaskOptions, timestep_s: float) -> int:
    """Physics steps per action."""
    return options.n_frames or max(1, round(_SECONDS_PER_ACTION / timestep_s))


def control_step_s(options: TaskOptions, model: Inventory) -> float:
    """Seconds per action."""
    timestep = options.timestep or model.timestep_s
    return num_substeps(options, timestep) * timestep


def parts_of(options: TaskOptions, model: Inventory) -> ModelParts:
    """The model as the terms name its parts."""
    names = [name for name, _ in acting(options, model)]
    feet = matching_in_turn(options.feet, model.bodies[1:])
    told = () if options.command is None else options.command.ranges
    command = tuple((each.name, each.unit) for each in told)
    parts = ModelParts(model, options.root or model.root, names, tuple(feet), command)
    if (reference := options.reference) is None:
        return parts
    compared = tuple(compared_bodies(reference, model))
    return replace(parts, compared=compared, frames_ahead=reference.ahead.frames)


def observed(options: TaskOptions) -> Sequence[ObservationTerm]:
    """The terms of the observation."""
    return options.observation or [Qpos(), Qvel()]


def placed_terms(
    terms: Iterable[ObservationTerm], parts: ModelParts
) -> Iterator[tuple[ObservationTerm, range]]:
    """Each term of an observation, with the places of its numbers in it."""
    start = 0
    for term in terms:
        end = start + sum(part.size for part in term.slices_of_history(parts))
        yield term, range(start, end)
        start = end


def reported(options: TaskOptions) -> Sequence[Term]:
    """The terms of the metrics."""
    if options.metrics is not None:
        return options.metrics
    travel = Travel(report=["x_position", "y_position", "height", "x_velocity", "y_velocity"])
    if options.reference is not None:
        return [travel, FollowedReference()]
    match options.command:
        case None:
            return [travel, DistanceFromStart()]
        case VelocityCommand():
            return [travel, DistanceFromStart(), FollowedCommand()]
        case PositionCommand():
            return [travel, DistanceFromStart(), FollowedPosition()]
        case _:  # A package's.
            return [travel, DistanceFromStart()]
