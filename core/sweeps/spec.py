"""The specification of a sweep: a job, the axes along which its settings vary, and when to stop."""

from typing import Annotated, Any, Literal, Self

from pydantic import Discriminator, Field, JsonValue, Tag, TypeAdapter, model_validator

from core.accounts.principal import AccountName
from core.bounds import LARGEST_AXIS_BYTES, within
from core.documents import Strict
from core.jobs.spec import LabelName, Note, Seed, SentSpec, Text

# More would be a queue that nobody reads, and a study that takes a sampler seconds for each draw.
MAX_TRIALS = 1000
# Values of a grid along a range that gives neither `points` nor `step`.
DEFAULT_POINTS = 5
# The most steps of a range. Beyond some 10¹⁵, doubles cannot tell the values apart.
_MOST_STEPS = 10**12
Method = Literal["grid", "random", "qmc", "tpe", "cma_es", "nsga2", "pbt"]
Number = int | float
_MOST = 10**18
Bound = Annotated[int, Field(ge=-_MOST, le=_MOST)] | Annotated[float, Field(ge=-1e300, le=1e300)]
StepLength = Annotated[int, Field(gt=0, le=_MOST)] | Annotated[float, Field(gt=0, le=1e300)]


class Range(Strict):
    """Numbers from `low` to `high`, both included; whole ones if all bounds are written without a point."""

    low: Bound
    high: Bound
    log: bool = Field(
        default=False, description="Even in the logarithm: 1e-5 to 1e-4 is as wide as 1e-4 to 1e-3."
    )
    step: StepLength | None = Field(default=None, description="Only low, low + step, … up to high.")
    points: int | None = Field(
        default=None,
        ge=1,
        le=MAX_TRIALS,
        description=f"For a grid: this many values, evenly spaced; {DEFAULT_POINTS} without a `step`.",
    )

    @model_validator(mode="after")
    def _is_a_range(self) -> Self:
        if self.low >= self.high:
            raise ValueError("`low` must be below `high`; for a single value, set it in `job`")
        if self.log and self.low <= 0:
            raise ValueError("with `log`, `low` must be above 0")
        if self.log and self.step is not None:
            raise ValueError("`log` and `step` exclude each other; give one of them")
        if self.step is not None and self.points is not None:
            raise ValueError("`step` and `points` exclude each other; give one of them")
        if self.step is not None and self.high - self.low > self.step * _MOST_STEPS:
            raise ValueError(
                f"`step` = {self.step:g} is so small that the range has more than {_MOST_STEPS:,} values"
            )
        return self

    @property
    def is_whole(self) -> bool:
        """Whether its values are integers."""
        return all(isinstance(one, int) for one in (self.low, self.high, self.step or 0))


def _form(value: Any) -> str:
    """Which of two forms was meant, so that a refusal speaks of that one alone."""
    return "list" if isinstance(value, list) else "object"


Choices = Annotated[list[JsonValue], Field(min_length=1, max_length=MAX_TRIALS), *within(LARGEST_AXIS_BYTES)]
Axis = Annotated[
    Annotated[Choices, Tag("list")] | Annotated[Range, Tag("object")],
    Discriminator(_form),
]
AxisName = Annotated[str, Field(min_length=1, max_length=200, examples=["algorithm.learning_rate"])]


class Objective(Strict):
    """The metric that a trial is judged by: its last value."""

    metric: str = Field(default="eval/episode_reward", min_length=1, max_length=200)
    direction: Literal["maximize", "minimize"] = "maximize"

    @property
    def sign(self) -> int:
        """1 where more is better, otherwise -1."""
        return 1 if self.direction == "maximize" else -1


class Budget(Strict):
    """When no further trial starts: at the first limit that is reached."""

    jobs: int | None = Field(
        default=None, ge=1, le=MAX_TRIALS, description="Trials; a grid has its own number."
    )
    parallel: int = Field(
        default=4, ge=1, le=100, description="Trials that are queued or run at the same time."
    )
    steps: int | None = Field(
        default=None,
        ge=1,
        le=10**15,
        description="Environment steps of all trials together: a trial starts only if all of its steps fit.",
    )
    gpu_hours: float | None = Field(
        default=None,
        gt=0,
        le=1e6,
        description="Hours of GPUs that trials held. Once they are spent no trial starts; those that run end "
        "as they would.",
    )

    @property
    def has_limit(self) -> bool:
        return (self.jobs, self.steps, self.gpu_hours) != (None, None, None)


class MedianPruning(Strict):
    """End a trial whose best value so far is worse than the median of ended trials at the same step.

    As in Golovin et al., Google Vizier (2017), and Optuna's MedianPruner.
    """

    kind: Literal["median"] = "median"
    startup_trials: int = Field(
        default=5, ge=1, le=MAX_TRIALS, description="Trials that end before any is pruned."
    )
    warmup_steps: int = Field(
        default=0, ge=0, le=10**12, description="Environment steps before which none is pruned."
    )


class HyperbandPruning(Strict):
    """Successive halving in several brackets, without waiting for stragglers.

    As in Li et al., Hyperband (2018) and ASHA (2020). A trial of bracket b is judged at `min_steps` ×
    `reduction_factor`^(b + k) steps, k = 0, 1, …: it goes on while it is among the best 1/`reduction_factor`
    of its bracket there.
    """

    kind: Literal["hyperband"] = "hyperband"
    min_steps: int = Field(ge=1, le=10**12, description="Environment steps before the first judgement.")
    reduction_factor: int = Field(default=3, ge=2, le=10)
    brackets: int = Field(default=1, ge=1, le=10, description="1: successive halving alone.")


Pruning = Annotated[MedianPruning | HyperbandPruning, Field(discriminator="kind")]


class Population(Strict):
    """Runs that train side by side, of which the worst resume from the best after each generation.

    As in Jaderberg et al., Population Based Training of Neural Networks (2017), section 4.1: truncation
    selection, and settings that are multiplied by a factor or drawn again.
    """

    size: int = Field(default=8, ge=2, le=100, description="Members, each a run of its own.")
    generations: int = Field(
        ge=2, le=MAX_TRIALS // 2, description="Equal parts of the job's num_timesteps; a trial trains one."
    )
    truncation: float = Field(
        default=0.25,
        gt=0,
        le=0.5,
        description="The share of members, at least one, that is replaced after each generation: by as many "
        "of the best.",
    )
    resample_probability: float = Field(
        default=0.25, ge=0, le=1, description="How often a replaced member's setting is drawn again."
    )
    perturbation_factors: Annotated[
        list[Annotated[float, Field(gt=0, le=100)]], Field(min_length=1, max_length=10)
    ] = Field(
        default=[0.8, 1.2],
        description="Otherwise a number is multiplied by one of these; a value of a list gives way to one "
        "beside it.",
    )

    @model_validator(mode="after")
    def _is_no_larger_than_a_sweep(self) -> Self:
        if self.num_trials > MAX_TRIALS:
            raise ValueError(
                f"{self.size} members in {self.generations} generations are {self.num_trials:,} trials, "
                f"but a sweep has {MAX_TRIALS:,} at most"
            )
        return self

    @property
    def num_trials(self) -> int:
        return self.size * self.generations

    @property
    def num_replaced(self) -> int:
        """Members that are replaced after a generation in which all succeeded."""
        return max(1, int(self.truncation * self.size + 1e-9))


MOST_SWEEP_LABELS = 60


class SweepSpec(Strict):
    """A job, the settings that vary between its trials, and what the trials are judged by."""

    name: Text | None = None
    project: AccountName | None = Field(
        default=None, description="That of all trials; by default the one that `job` says."
    )
    labels: dict[LabelName, Text] = Field(
        default={}, max_length=MOST_SWEEP_LABELS, description="The trials get them, too."
    )
    note: Note | None = Field(default=None, description="Plain text about it, for people.")
    job: SentSpec
    method: Method = "random"
    parameters: dict[AxisName, Axis] = Field(
        max_length=64,
        description="Values, or a range, by the field's path in the job, such as `algorithm.learning_rate`.",
    )
    objective: Annotated[
        Annotated[list[Objective], Field(min_length=1, max_length=4), Tag("list")]
        | Annotated[Objective, Tag("object")],
        Discriminator(_form),
    ] = Objective()
    budget: Budget = Budget()
    pruning: Pruning | None = None
    population: Population | None = Field(default=None, description="For the method `pbt`.")
    seed: Seed = Field(
        default=0, description="Of the draws; trials have the seed that `job` or an axis says."
    )

    @property
    def objectives(self) -> list[Objective]:
        return self.objective if isinstance(self.objective, list) else [self.objective]

    @property
    def has_own_end(self) -> bool:
        """Whether it ends without a limit of its budget."""
        return self.method in ("grid", "pbt")


SWEEP_SPEC: TypeAdapter[SweepSpec] = TypeAdapter(SweepSpec)
