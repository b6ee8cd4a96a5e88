"""The protocol between a training process and its supervisor.

The process sends one JSON document per line, over a pipe of their own. The supervisor gives it a task, and
sends two signals (`worker/stopping.py`).
"""

from math import isfinite
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter

from core.bounds import PastStep
from core.documents import Stored
from core.jobs.job import ArtifactRole, JobPhase
from core.jobs.spec import SentSpec
from core.physics.availability import BodySize, EngineName
from core.reasons import Reason

# Bytes of a line; the supervisor does not read a longer one.
LONGEST_MESSAGE = 2**20


class Hello(Stored):
    """The process runs; nothing heavy is loaded yet."""

    type: Literal["hello"] = "hello"
    pid: int


class Started(Stored):
    """The facts that the process found: its device, its engine and the reason for it, its hyperparameters."""

    type: Literal["started"] = "started"
    device: str
    engine: str
    details: dict[str, Any] = {}


class PhaseBegan(Stored):
    """The phase that the process is in from now on, for the job's progress."""

    type: Literal["phase_began"] = "phase_began"
    phase: JobPhase


class PhaseEnded(Stored):
    """A part of the start-up has ended, after `seconds`."""

    type: Literal["phase"] = "phase"
    name: str
    seconds: float


class Advanced(Stored):
    """Training reached `step` of `total` environment steps."""

    type: Literal["progress"] = "progress"
    step: int
    total: int
    steps_per_second: float | None = None
    eta_s: float | None = None


class Measured(Stored):
    """A row of metrics that belongs to `step`. values: null where one is not finite, for JSON has none."""

    type: Literal["metrics"] = "metrics"
    step: PastStep
    values: dict[str, float | None]

    @property
    def finite(self) -> dict[str, float]:
        """The values that are finite."""
        return {name: value for name, value in self.values.items() if value is not None and isfinite(value)}


class FileReady(Stored):
    """A whole file is in the spool under `path`; it will not change again."""

    type: Literal["file"] = "file"
    name: str
    path: str
    role: ArtifactRole
    media_type: str
    step: int | None = None
    metadata: dict[str, Any] = {}


class Noted(Stored):
    """Something that users should know and that is not a failure."""

    type: Literal["note"] = "note"
    text: str


class MemoryPeak(Stored):
    """The most that the run has had of each GPU's memory, in bytes."""

    type: Literal["memory"] = "memory"
    bytes: int


class Failed(Stored):
    """The job cannot succeed, and why."""

    type: Literal["failed"] = "failed"
    reason: Reason
    message: str


class Finished(Stored):
    """Everything asked for is done; `stopped` where a signal cut it short."""

    type: Literal["finished"] = "finished"
    stopped: bool = False


Message = Annotated[
    Hello
    | Started
    | PhaseBegan
    | PhaseEnded
    | Advanced
    | Measured
    | MemoryPeak
    | FileReady
    | Noted
    | Failed
    | Finished,
    Field(discriminator="type"),
]
MESSAGE: TypeAdapter[Message] = TypeAdapter(Message)


class BestSoFar(Stored):
    """The policy of a job's best evaluation in the attempts before. path: of its file in the spool.

    seed: whose policy it is, in a job of several seeds.
    """

    seed: int | None = None
    path: str
    step: int
    episode_return: float


class GangPart(Stored):
    """The part of a process in a job that several hosts share. coordinator: the address at which that of rank
    0 coordinates them, and bind: where it listens there; None: at all of the machine's addresses."""

    hosts: int
    rank: int
    coordinator: str
    bind: str | None = None


class Task(Stored):
    """The task that the supervisor leaves in the spool, as `task.json`, for the training process.

    device: `cpu`, `gpu:<index>`, or `gpu:<index>,<index>`. gpu_part: of the GPU's memory, if it shares the
    GPU. correlation_id: the job's. checkpoint: path of the
    state to resume from (training), or to take the policy from (rollout). checkpoint_step: its environment
    step. policy_of: the algorithm, where it is the file of a policy instead. policy_seed: whose policy to
    take from a checkpoint of several seeds. best: of a training's earlier attempts, one for each seed. model:
    path of the user's own model, if the job names one. clips: paths of the clips that its reference names, by
    their ids. decoder: path of the policy whose decoder acts, if the job's task names one. experts: of a
    distillation, the path of each expert's policy and the algorithm that made it.
    engines_that_cannot: engines that cannot run it, with
    the reasons. body: its size; None if it is not known. begun_on: the engine of the job's own checkpoint,
    which `auto` then takes again. source_engine: the engine that moved the environments in another job's
    checkpoint, which `auto` takes if no other can. new_clips: whether the checkpoint is of
    a job with other clips. made_with: the versions of packages
    that made the checkpoint, where they are known. commit: of the code that runs. gang: None where one host
    has the job.
    """

    job_id: str
    attempt: int
    spec: SentSpec
    device: str
    gpu_part: float | None = None
    correlation_id: str | None = None
    checkpoint: str | None = None
    checkpoint_step: int = 0
    policy_of: str | None = None
    policy_seed: int | None = None
    best: tuple[BestSoFar, ...] = ()
    model: str | None = None
    clips: dict[str, str] = {}
    decoder: str | None = None
    experts: tuple[tuple[str, str], ...] = ()
    engines_that_cannot: dict[EngineName, str] = {}
    body: BodySize | None = None
    begun_on: EngineName | None = None
    source_engine: EngineName | None = None
    new_clips: bool = False
    made_with: dict[str, str] = {}
    commit: str | None = None
    gang: GangPart | None = None
