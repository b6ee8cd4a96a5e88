"""Hyperparameters that algorithms share, and what code for any algorithm reads of them."""

from abc import abstractmethod
from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field

from core.documents import Strict
from core.environments.info import CRITIC_GROUP, EnvironmentInfo
from core.errors import Problem, Rejected

NumTimesteps = Annotated[
    int,
    Field(
        ge=1,
        le=10**12,
        description="Environment steps to train for, those before a checkpoint that it resumes included.",
    ),
]
NumEnvs = Annotated[int, Field(ge=1, le=2**20, description="Environments that run side by side.")]
EpisodeLength = Annotated[
    int,
    Field(
        ge=1, le=10**6, description="Steps after which an episode is cut off, rounded up to whole actions."
    ),
]
ResetPoolSize = Annotated[
    int,
    Field(
        ge=0,
        le=2**16,
        description="Fresh initial states drawn per update; each episode that begins in it starts from a "
        "random one of them. 0: every environment returns to its own first state, as in Brax.",
    ),
]
NormalizeObservations = Annotated[
    bool, Field(description="Normalise the networks' observations to mean 0 and deviation 1.")
]
NormalizeObservationsMaxAbsValue = Annotated[
    float | None,
    Field(
        gt=0,
        le=1e6,
        description="Bound on normalised observations, in standard deviations. null: no bound, as in Brax.",
    ),
]
NumEvals = Annotated[
    int, Field(ge=0, le=10_000, description="Evaluations, spread evenly; the last is at the end.")
]
NumEvalEnvs = Annotated[int, Field(ge=1, le=2**16, description="Episodes per evaluation.")]


class BaseSpec(Strict):
    """An algorithm's hyperparameters; a subclass adds `kind` and its fields.

    A run also reads what `core.algorithms.algorithm.RunSettings` names, as fields or properties.

    fixed_by_checkpoint: names of the values that a resumed run must share with its checkpoint; all others
    may change. checkpoint_holds_envs: whether a resumed run continues in the environments that it left.
    arguments: names of the numbers that are arguments of the compiled programs, which another value does not
    change. why_no_seeds: why a job cannot train several seeds (`core.algorithms.seeds`), as the end of a
    sentence; None where it can.
    reads_critic: whether its value function may see another observation than its policy.
    trains_in_parts: whether a run that ends and is resumed with a greater `num_timesteps` becomes the run
    that had the greater one from the beginning: nothing in it depends on its length.
    """

    fixed_by_checkpoint: ClassVar[tuple[str, ...]] = ()
    checkpoint_holds_envs: ClassVar[bool] = False
    arguments: ClassVar[tuple[str, ...]] = ()
    why_no_seeds: ClassVar[str | None] = "it trains one at a time"
    reads_critic: ClassVar[bool] = False
    trains_in_parts: ClassVar[bool] = False

    @classmethod
    def algorithm(cls) -> str:
        """The only value of `kind`."""
        return cls.model_fields["kind"].default

    @property
    @abstractmethod
    def num_parallel_envs(self) -> int:
        """How many environments a run steps side by side for most of its time."""

    @property
    @abstractmethod
    def budget(self) -> int:
        """Environment steps that the run was asked to take; a last update may pass it."""

    @property
    def read_at_start(self) -> tuple[str, ...]:
        """Names of the settings that a run reads only at its beginning: a resumed one may have others, which
        change nothing."""
        return ()

    @property
    def unread(self) -> Mapping[str, str]:
        """Why settings are not read beside the others, as a sentence by their names: by default, all are."""
        return {}

    def of_environment(self, environment: EnvironmentInfo) -> Self:
        """The settings with what they take from the environment's observation: by default, nothing.

        Raises Rejected where it lacks what they need.
        """
        return self

    def check_sharing(self, num_devices: int, num_hosts: int = 1) -> None:
        """Raises Rejected where `num_devices` devices, those of all hosts together, cannot share the run: by
        default, more than one."""
        if num_hosts > 1:
            detail = f"{self.algorithm()} runs on one host, but the job asks for {num_hosts}."
            raise Rejected(detail, [Problem("/resources/hosts", detail)])
        if num_devices > 1:
            detail = f"{self.algorithm()} runs on one device, but the job asks for {num_devices} GPUs."
            raise Rejected(detail, [Problem("/resources/gpus", detail)])

    def check_seeds(self) -> None:
        """Raises Rejected where a job cannot train several seeds."""
        if self.why_no_seeds is not None:
            detail = f"{self.algorithm()} takes no `seeds`: {self.why_no_seeds}."
            raise Rejected(detail, [Problem("/seeds", detail)])


def rejected(detail: str, *names: str) -> Rejected:
    """The refusal of these hyperparameters together."""
    return Rejected(detail, [Problem(f"/algorithm/{name}", detail) for name in names])


def changed_beside_checkpoint(wanted: BaseSpec, made_with: BaseSpec) -> list[str]:
    """The names of what differs, and may not in a run that resumes from a checkpoint: fields, and what
    follows from them."""
    names = ("kind",) if type(wanted) is not type(made_with) else wanted.fixed_by_checkpoint
    return [name for name in names if getattr(made_with, name) != getattr(wanted, name)]


def check_resumption(wanted: BaseSpec, made_with: BaseSpec) -> None:
    """Raises Rejected if a run under `wanted` cannot resume from a checkpoint of one under `made_with`."""
    problems = [
        Problem(
            f"/algorithm/{name}" if name in type(wanted).model_fields else "/algorithm",
            f"The checkpoint was made with {name} = {getattr(made_with, name)}; this job has "
            f"{getattr(wanted, name)}.",
        )
        for name in changed_beside_checkpoint(wanted, made_with)
    ]
    if problems:
        raise Rejected(
            "The job cannot resume from that checkpoint. " + " ".join(problem.detail for problem in problems),
            problems,
        )


def check_critic(settings: BaseSpec, environment: EnvironmentInfo) -> Rejected | None:
    """The refusal of an observation for the value function alone, under an algorithm that learns from one."""
    if settings.reads_critic or CRITIC_GROUP not in environment.observations:
        return None
    detail = (
        f"{settings.algorithm()} learns from one observation, so nothing would see the critic's: leave "
        "`critic` out, or take ppo."
    )
    places = ("/environment/options/critic", "/algorithm/kind")
    return Rejected(detail, [Problem(place, detail) for place in places])


def check_curriculum(reset_pool_size: int, environment: EnvironmentInfo) -> Rejected | None:
    """The refusal of a curriculum that changes nothing: environments always return to their first states."""
    if reset_pool_size or not environment.has_curriculum:
        return None
    name = environment.curriculum_option.replace("/", ".")
    detail = (
        "With reset_pool_size = 0 every environment returns to its own first state for the whole run, so a "
        f"curriculum would change nothing: leave reset_pool_size out, or give up that of `{name}`."
    )
    option = f"/environment/options/{environment.curriculum_option}"
    places = ("/algorithm/reset_pool_size", option)
    return Rejected(detail, [Problem(place, detail) for place in places])


Share = Annotated[float, Field(ge=0, le=1)]
EpsilonShape = Literal["linear", "exponential"]
# The place of a schedule in a job.
EPSILON_POINTER = "/algorithm/epsilon"


class EpsilonSchedule(Strict):
    """The share of choices that are made at random: from `start` to `end`, and then it stays."""

    start: Share = 0.5
    end: Share = 0.05
    decay_decisions: int | None = Field(
        default=None,
        ge=1,
        le=10**12,
        description="Decisions until `end`, those of a learner in all of its environments. By default: all "
        "of the run's.",
    )
    shape: EpsilonShape = "linear"

    def problems(self, num_decisions: int, *ends: float | None) -> list[Problem]:
        """Its fault in a run of this number of decisions; ends: other values of start and end
        that a part of the run takes."""
        problems = list[Problem]()
        if self.decay_decisions is not None and self.decay_decisions > num_decisions:
            detail = (
                f"decay_decisions = {self.decay_decisions:,}, and the run has {num_decisions:,} decisions "
                "of an agent."
            )
            problems.append(Problem(f"{EPSILON_POINTER}/decay_decisions", detail))
        if self.shape == "exponential" and 0.0 in (self.start, self.end, *ends):
            detail = "An exponential schedule of epsilon never comes from or to 0; take a small number."
            problems.append(Problem(f"{EPSILON_POINTER}/shape", detail))
        return problems
