"""The specification of a job: a union discriminated by `kind`. Validation here checks only its shape;
`core.jobs.checks` checks whether its parts fit together."""

import re
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self, cast

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    PlainSerializer,
    TypeAdapter,
    model_validator,
)

from core.accounts.principal import AccountName
from core.algorithms.battery.spec import BatterySpec
from core.algorithms.catalog import ALGORITHMS, DEFAULT_ALGORITHM, AlgorithmSpec
from core.algorithms.distillation.spec import DistillationSpec
from core.bounds import LONGEST_NAME, LONGEST_NOTE, MOST_ITEMS, FreeOptions, PastStep
from core.documents import Strict
from core.environments.randomization import Randomizations
from core.news.webhook import MAX_WEBHOOKS, WebhookName
from core.patterns import PATTERNS, Patterns
from core.physics.availability import PhysicsChoice
from core.rendering.layout import Layout
from core.rendering.request import Overlay

_JOB_ID = r"^[0-9a-f]{12}-[0-9a-f]{10}$"
JobId = Annotated[str, Field(pattern=_JOB_ID, examples=["019aa3c2f0b1-5be0c1d2e3"])]
Seed = Annotated[int, Field(ge=0, le=2**31 - 1)]
# The most seeds of one training: as many ants as an H100 was measured with.
MOST_SEEDS = 16


def _different(seeds: list[int]) -> list[int]:
    if len(set(seeds)) < len(seeds):
        raise ValueError("each seed must be there once")
    return seeds


Seeds = Annotated[
    list[Seed], Field(min_length=2, max_length=MOST_SEEDS, examples=[[0, 1, 2]]), AfterValidator(_different)
]


def _without_null(value: str) -> str:
    if "\0" in value:
        raise ValueError("must not contain the character U+0000, which no database stores as text")
    return value


# Text by which jobs can be found.
Text = Annotated[str, Field(max_length=LONGEST_NAME), AfterValidator(_without_null)]
Note = Annotated[
    str,
    Field(max_length=LONGEST_NOTE, examples=["The knees were too stiff; compare with the next one."]),
    AfterValidator(_without_null),
]
LabelName = Annotated[str, Field(min_length=1, max_length=63, pattern=r"^[A-Za-z0-9_.-]+$")]
MOST_LABELS = 64
Priority = Literal["high", "normal", "low"]
Accelerator = Literal["any", "cpu", "gpu"]
JobKind = Literal["train", "rollout"]


def _even(value: int) -> int:
    if value % 2:
        raise ValueError("must be even: H.264 in yuv420p halves the colour's resolution")
    return value


PixelCount = Annotated[int, Field(ge=16, le=3840), AfterValidator(_even)]


EnvironmentId = Annotated[str, Field(min_length=1, max_length=100)]


class EnvironmentSpec(Strict):
    """An environment by its id, with the environment's own options."""

    id: EnvironmentId = Field(examples=["ant"])
    options: FreeOptions = {}


def _bare_id(value: Any) -> Any:
    return {"id": value} if isinstance(value, str) else value


def decoder_job(environment: EnvironmentSpec) -> str | None:
    """The id of the job whose decoder acts in the environment's task, if one does.

    Options that are not checked yet may say anything: what can be no job's id is none.
    """
    action: Any = environment.options.get("action")
    if not isinstance(action, dict):
        return None
    said = cast("dict[str, Any]", action)
    job = str(said.get("job")) if said.get("kind") == "decoder" else ""
    return job if re.fullmatch(_JOB_ID, job) else None


EnvironmentChoice = Annotated[
    EnvironmentSpec, BeforeValidator(_bare_id, json_schema_input_type=EnvironmentSpec | EnvironmentId)
]


class CheckpointsSpec(Strict):
    """The interval of a run's checkpoints, and the number of them that are kept."""

    every_steps: int | None = Field(
        default=None,
        ge=1,
        le=10**12,
        description="Environment steps between checkpoints; by default a tenth of the budget.",
    )
    every_seconds: float = Field(
        default=600.0,
        ge=1,
        le=30 * 86_400,
        description="Seconds of training after which a checkpoint is made regardless of the steps: a lost "
        "worker costs at most this much.",
    )
    keep: int = Field(default=5, ge=1, le=1000, description="How many of the newest checkpoints are kept.")


CameraName = Annotated[str, Field(max_length=LONGEST_NAME)] | Annotated[int, Field(ge=0, le=MOST_ITEMS)]


class VideoSpec(Strict):
    """The job's videos: their subjects, size and length."""

    camera: CameraName = Field(
        default="track", description="`track`, or a camera of the model by name or number."
    )
    cameras: list[CameraName] | None = Field(
        default=None,
        min_length=1,
        max_length=16,
        description="Several cameras, side by side from the left, instead of `camera`.",
    )
    episodes: int = Field(
        default=1,
        ge=1,
        le=64,
        description="Episodes shown at the same time, one below the other, more than four in a grid; one "
        "that has ended stands still, darkened. With 1, episodes follow one another.",
    )
    show: list[Overlay] = Field(
        default=[],
        max_length=4,
        description="Drawn besides the body: its `joints`, its points of contact (`contacts`), the "
        "`centre_of_mass`; `transparent`: one sees through the body.",
    )
    reference: bool = Field(
        default=True,
        description="Of a body that follows clips: draw, translucent, the body as the clip has it.",
    )
    width: PixelCount = Field(default=640, description="Width of each picture, in pixels.")
    height: PixelCount = Field(default=480, description="Height of each picture, in pixels.")
    fps: int = Field(default=30, ge=1, le=120)
    seconds: float = Field(default=10.0, gt=0, le=600)
    every_checkpoint: bool = Field(
        default=False, description="Make a video for each checkpoint, besides the final one."
    )

    @model_validator(mode="after")
    def _one_way_to_say_it(self) -> Self:
        if self.cameras is not None and "camera" in self.model_fields_set:
            raise ValueError("`camera` and `cameras` exclude each other; give one of them")
        return self

    @property
    def shown(self) -> list[str | int]:
        """The cameras, from the left."""
        return [self.camera] if self.cameras is None else self.cameras

    @property
    def layout(self) -> Layout:
        """Where each picture stands."""
        return Layout(self.width, self.height, len(self.shown), self.episodes)


# The most GPUs of one host that one job may share, and the most hosts.
MOST_GPUS, MOST_HOSTS = 64, 64


class ResourcesSpec(Strict):
    """The devices that the job needs from a worker."""

    accelerator: Accelerator = "any"
    gpus: int = Field(
        default=1,
        ge=1,
        le=MOST_GPUS * MOST_HOSTS,
        description="How many GPUs share a training, those of all `hosts` together; where it is given, "
        "`any` means `gpu`. num_envs and batch_size must be multiples of this number.",
    )
    hosts: int = Field(
        default=1,
        ge=1,
        le=MOST_HOSTS,
        description="How many machines share a training, each with an equal part of the GPUs; or each with "
        "its CPU, where `accelerator` is `cpu`.",
    )
    share_gpu: bool = Field(
        default=False,
        description="Whether the job may have a part of a GPU, beside others; `any` then means `gpu`. How "
        "much memory it needs is known from jobs like it; the first of its kind has a GPU alone.",
    )
    gpu_memory_gib: float | None = Field(
        default=None,
        ge=0.25,
        le=1024,
        description="GiB of the memory of the GPU that the job shares, in place of what was measured. It "
        "gets no more.",
    )

    @property
    def kind(self) -> Accelerator:
        """The kind of worker that the job needs: a job that says how many GPUs it shares needs one."""
        if self.accelerator == "any" and ("gpus" in self.model_fields_set or self.share_gpu):
            return "gpu"
        return "gpu" if self.gpus > 1 else self.accelerator

    @property
    def gpu_bytes(self) -> int | None:
        """What it asks for of a GPU's memory."""
        return None if self.gpu_memory_gib is None else int(self.gpu_memory_gib * 2**30)

    @property
    def num_devices(self) -> int:
        """How many devices share the run: GPUs, or a CPU of each host."""
        return self.hosts if self.kind == "cpu" else self.gpus


class ResumePoint(Strict):
    """A checkpoint of another job; without a step, its newest."""

    job: JobId
    step: PastStep | None = None


class WandbSpec(Strict):
    """A Weights & Biases run: configuration, all metrics, videos and policy. The worker has the API key."""

    project: str = Field(min_length=1, max_length=128, pattern=r"^[^/\\#?%:]+$", examples=["vnl"])
    entity: str | None = Field(
        default=None,
        max_length=128,
        pattern=r"^[A-Za-z0-9_-]+$",
        description="Team or user; by default that of the key.",
    )
    name: str | None = Field(
        default=None,
        min_length=1,
        max_length=128,
        description="By default the job's name; without one such as `ant_ppo_5be0c1d2e3`: the environment, "
        "the label `task_name` if there is one, the algorithm, the end of the job's id.",
    )
    mode: Literal["online", "offline"] = Field(
        default="online",
        description="offline: nothing is sent; the run becomes an artifact for `wandb sync`.",
    )


class TrackingSpec(Strict):
    """The services that track the run, besides this one."""

    wandb: WandbSpec | None = None


def _default_if_true(value: Any) -> Any:
    return ({} if value else None) if isinstance(value, bool) else value


class _Common(Strict):
    name: Text | None = None
    project: AccountName | None = Field(
        default=None, description="Who may see it; with one project of your own you need not say it."
    )
    labels: dict[LabelName, Text] = Field(default={}, max_length=MOST_LABELS)
    note: Note | None = Field(default=None, description="Plain text about it, for people.")
    environment: EnvironmentChoice
    physics: PhysicsChoice = "auto"
    randomization: Randomizations = Field(
        default=[],
        description="What differs between the parallel environments, in training, evaluations and videos "
        "alike; the rules apply in order.",
    )
    seed: Seed = 0
    video: VideoSpec | None = Field(default=VideoSpec(), description="null: no video is made.")
    battery: Annotated[
        BatterySpec | None,
        BeforeValidator(_default_if_true, json_schema_input_type=BatterySpec | bool | None),
    ] = Field(
        default=None,
        description="Test the policy in the end, under eight velocity commands or on the clips that it "
        "follows, in C MuJoCo; true: as usual.",
    )
    resources: ResourcesSpec = ResourcesSpec()
    priority: Priority = "normal"
    timeout_s: float = Field(
        default=86_400.0,
        gt=0,
        le=30 * 86_400,
        description="Seconds an attempt may take.",
    )
    max_attempts: int = Field(default=3, ge=1, le=100, description="Attempts allowed when workers are lost.")
    notify: list[WebhookName] = Field(
        default=[],
        max_length=MAX_WEBHOOKS,
        description="Webhooks of its project that are told of this job, whatever jobs they are for.",
        examples=[["lab-chat"]],
    )


@dataclass(frozen=True)
class Source:
    """A checkpoint of another job, step None: its newest; or the policy of its best evaluation.

    pointer: its place in the document. seed: whose policy is wanted, of a job of several seeds.
    """

    job: str
    step: int | None
    pointer: str
    is_best: bool = False
    seed: int | None = None


class TrainSpec(_Common):
    """Train a policy; keep checkpoints, metrics and a video."""

    kind: Literal["train"] = "train"
    seeds: Seeds | None = Field(
        default=None,
        description="In place of `seed`: a policy for each, trained side by side in one program. Each has "
        "metrics (`seed_<n>/…`), policies and videos (`…-seed-<n>`) of its own; a metric's plain name is the "
        "mean over the seeds. Steps count those of each seed.",
    )
    algorithm: AlgorithmSpec = cast("AlgorithmSpec", ALGORITHMS[DEFAULT_ALGORITHM].spec())
    checkpoints: CheckpointsSpec = CheckpointsSpec()
    resume_from: ResumePoint | None = None
    preemptible: bool = Field(
        default=False,
        description="Whether it makes room for a job of the same priority whose user has used less of late; "
        "it goes on later from where it stood. For jobs of higher priority every training makes room.",
    )
    tracking: TrackingSpec = TrackingSpec()

    @model_validator(mode="after")
    def _one_way_to_say_the_seed(self) -> Self:
        if self.seeds is not None and "seed" in self.model_fields_set:
            raise ValueError("`seed` and `seeds` exclude each other; give one of them")
        return self

    def of_seed(self, seed: int) -> Self:
        """The training of one of its seeds alone."""
        return self.model_copy(update={"seed": seed, "seeds": None})

    @property
    def source(self) -> Source | None:
        """The checkpoint that it resumes from."""
        point = self.resume_from
        return None if point is None else Source(point.job, point.step, "/resume_from")


class CheckpointPolicy(Strict):
    """The policy in a training job's checkpoint (without a step, its newest), or of its best evaluation."""

    kind: Literal["checkpoint"] = "checkpoint"
    job: JobId
    step: PastStep | None = None
    which: Literal["last", "best"] = Field(
        default="last",
        description="`best`: the policy whose evaluation had the highest return, in place of a checkpoint's.",
    )
    seed: Seed | None = Field(
        default=None, description="Whose policy, if the job trained several seeds; by default the first."
    )

    @model_validator(mode="after")
    def _one_way_to_say_it(self) -> Self:
        if self.which == "best" and self.step is not None:
            raise ValueError("`step` and the best policy exclude each other; give one of them")
        return self


class RandomPolicy(Strict):
    """Each action component uniform in [-1, 1]."""

    kind: Literal["random"] = "random"


class ZeroPolicy(Strict):
    """Each action component 0."""

    kind: Literal["zero"] = "zero"


class ConstantPolicy(Strict):
    """The same action at every step."""

    kind: Literal["constant"] = "constant"
    action: list[Annotated[float, Field(ge=-1, le=1)]] = Field(min_length=1, max_length=1000)


PolicyChoice = Annotated[
    CheckpointPolicy | RandomPolicy | ZeroPolicy | ConstantPolicy, Field(discriminator="kind")
]


def _that_of_the_job() -> EnvironmentSpec:
    """Stands for the environment that a rollout leaves out, until the submission fills it in."""
    return EnvironmentSpec.model_construct(id="")


class RecordingSpec(Strict):
    """What a rollout's `recording.h5` holds besides its trajectory: where each body is, and the activations
    of the policy's layers (docs/neuroscience.md)."""

    layers: Patterns | None = Field(
        default=None,
        description="The layers, named by network and number: `policy/0`, or of a policy with an encoder "
        "`encoder/0`, `latent/mean`, `latent/std`, `latent/sample`, `decoder/0`. null: all that the policy "
        f"has. {PATTERNS}",
        examples=[["encoder/.*", "latent/mean"]],
    )


class RolloutSpec(_Common):
    """Run a policy; keep the trajectory, a summary and a video."""

    kind: Literal["rollout"] = "rollout"
    environment: EnvironmentChoice = Field(
        default_factory=_that_of_the_job,
        description="With a checkpoint's policy it may be left out: that of the checkpoint's job is taken.",
    )
    policy: PolicyChoice
    num_steps: int = Field(
        default=1000, ge=1, le=100_000, description="The most environment steps in an episode."
    )
    num_episodes: int = Field(default=1, ge=1, le=1000)
    deterministic: bool = True
    recording: Annotated[
        RecordingSpec | None,
        BeforeValidator(_default_if_true, json_schema_input_type=RecordingSpec | bool | None),
    ] = Field(
        default=None,
        description="Keep an HDF5 file of all that was seen, done and computed in every step; true: with "
        "all layers of the policy.",
    )

    @property
    def source(self) -> Source | None:
        """The checkpoint whose policy acts."""
        policy = self.policy
        if not isinstance(policy, CheckpointPolicy):
            return None
        is_best = policy.which == "best"
        return Source(policy.job, policy.step, "/policy", is_best=is_best, seed=policy.seed)


JobSpec = Annotated[TrainSpec | RolloutSpec, Field(discriminator="kind")]


def _as_sent(spec: TrainSpec | RolloutSpec) -> dict[str, Any]:
    return {"kind": spec.kind, **spec.model_dump(mode="json", exclude_unset=True)}


# A specification inside a stored document. Fields that the client did not send stay unset: tuned defaults
# fill them where the job runs.
SentSpec = Annotated[JobSpec, PlainSerializer(_as_sent, return_type=dict[str, Any])]
JOB_SPEC: TypeAdapter[TrainSpec | RolloutSpec] = TypeAdapter(JobSpec)


def experts_of(spec: JobSpec) -> list[str]:
    """The ids of the jobs from whose policies it learns, each once."""
    algorithm = spec.algorithm if isinstance(spec, TrainSpec) else None
    experts = algorithm.experts if isinstance(algorithm, DistillationSpec) else ()
    return list(dict.fromkeys(expert.job for expert in experts))


def lenders_of(spec: JobSpec) -> list[str]:
    """The ids of the jobs whose policies it needs, besides that of its `source`."""
    decoder = decoder_job(spec.environment)
    return [*([] if decoder is None else [decoder]), *experts_of(spec)]
