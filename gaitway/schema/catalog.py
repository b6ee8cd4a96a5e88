"""Environments, users' own models and clips, which a job may name; stills; the workers that run jobs, how
many are wanted, and what was used."""

from collections.abc import Mapping
from datetime import datetime
from typing import Any

from pydantic import ConfigDict, Field, JsonValue

from gaitway.schema.base import (
    Device,
    EngineName,
    ModelContents,
    PreviewStatus,
    UploadStatus,
    View,
    WorkerState,
)


class SliceView(View):
    """A part of an observation, or of an action: `size` numbers from `start` on.

    name: the same for neighbouring slices of one array, each of which has one unit. unit: `1` for numbers
    without one; several, in the order of a row, where rows of different quantities repeat; None where it is
    not known. low, high: of an observation bounds that its values keep, up to rounding, or None; of an
    action, whose numbers lie in [-1, 1], what -1 and 1 set. components: a name for each number; empty where
    they are not known.
    """

    name: str
    start: int
    size: int
    unit: str | None = None
    low: float | None = None
    high: float | None = None
    components: tuple[str, ...] = ()


class EnvironmentView(View):
    """An environment. dt: seconds between actions; options: their JSON Schema.

    tuned: hyperparameters that fit it, by algorithm and device. environment_options: by algorithm, the
    options that a job takes where it leaves them out, because `tuned` is made for them. family: `gaitway`, or
    the package that provides it. cannot_run: engines that cannot run it, each with the reason.
    Sizes and dt are null where they depend on the model that the options name.
    """

    # A client keeps members that it does not know as attributes.
    model_config = ConfigDict(extra="allow")

    id: str
    family: str = ""
    description: str = ""
    observation_size: int | None = None
    action_size: int | None = None
    dt: float | None = None
    episode_length: int = 0
    cameras: tuple[str, ...] = ()
    options: dict[str, Any] = {}
    tuned: Mapping[str, Mapping[Device, Mapping[str, Any]]] = {}
    environment_options: Mapping[str, Mapping[str, Any]] = {}
    cannot_run: Mapping[EngineName, str] = {}


class EnvironmentDetails(EnvironmentView):
    """An environment under the given options, and what a job on it gets by default.

    defaults: every hyperparameter of a job that sets none, by algorithm and device. An algorithm that needs
    more than its defaults on this environment is left out.
    observation, action: their numbers in order, with units and bounds; empty where they depend on a model
    that the options do not name. critic: those that only the value function sees, if it sees others.
    metrics: what a job reports, by algorithm and for `rollout`; without the terms of a reward that depend on
    options, `eval/episode_…`. parts: the names that terms of a task may use, by kind (`bodies`, `joints`,
    `geoms`, `sensors`, `keyframes`), where it is one of terms whose model is known.
    """

    observation: tuple[SliceView, ...] = ()
    action: tuple[SliceView, ...] = ()
    critic: tuple[SliceView, ...] = ()
    defaults: Mapping[str, Mapping[Device, Mapping[str, Any]]] = {}
    metrics: Mapping[str, tuple[str, ...]] = {}
    parts: Mapping[str, tuple[str, ...]] = {}


class ModelView(View):
    """A model. description: set once it is `ready`; message: why it was `refused`; size: bytes."""

    id: str
    name: str | None = None
    owner: str | None = Field(None, description="Who sent it to the project; null without accounts.")
    project: str = "default"
    status: UploadStatus
    media_type: str = ""
    size: int = 0
    created_at: datetime
    description: ModelContents | None = Field(
        None, description="Its contents, and the engines that can run it."
    )
    message: str | None = None
    links: dict[str, str] = {}

    @property
    def recipe_job(self) -> dict[str, JsonValue] | None:
        """A job in which it learns to walk by command, filled in from the model; None if it has no recipe."""
        recipe = (self.description or {}).get("recipe")
        if not recipe:
            return None
        options = {"model": self.id, **recipe}
        return {"kind": "train", "environment": {"id": "mjcf", "options": options}, "battery": True}


class ClipView(View):
    """A clip. rate: frames per second; seconds: from its first frame to its last; warnings: what may be wrong
    with it."""

    name: str
    num_frames: int = 0
    rate: float = 0.0
    seconds: float = 0.0
    warnings: list[str] = []


class KeyPointView(View):
    """A key point that a clip follows. body, offset: the point of the body that it is, in m, as fitted.
    mean_distance, worst_distance: m between the two, over the num_seen frames that have it."""

    name: str
    body: str = ""
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    num_seen: int = 0
    mean_distance: float | None = None
    worst_distance: float | None = None


class ClipsContents(View):
    """What is in a file of clips. format: how it is laid out; joints: those that the clips move; key_points:
    of a recording of such. num_replayed: how many of the clips its replay shows, each as an episode;
    no_replay: why there is none."""

    format: str = ""
    clips: list[ClipView] = []
    joints: list[str] = []
    key_points: list[KeyPointView] = []
    num_replayed: int = 0
    no_replay: str | None = None


class ClipFileView(View):
    """A file of clips. body: whose they are; rate: as it was sent. description: set once it is `ready`;
    message: why it was `refused`, or how far key points are fitted while it is `validating`; size: bytes."""

    id: str
    name: str | None = None
    owner: str | None = Field(None, description="Who sent it to the project; null without accounts.")
    project: str = "default"
    status: UploadStatus
    body: str = ""
    rate: float | None = None
    media_type: str = ""
    size: int = 0
    created_at: datetime
    description: ClipsContents | None = None
    message: str | None = None
    links: dict[str, str] = {}


class StillView(View):
    """A still. camera: as a job's `video` names it; size: bytes; href: where to fetch the PNG."""

    camera: str | int
    size: int = 0
    sha256: str = ""
    href: str


class PreviewView(View):
    """An environment as the first episode of a rollout with seed 0 begins. options: all, with defaults."""

    environment: str
    options: dict[str, JsonValue] = {}
    status: PreviewStatus
    cameras: tuple[str | int, ...] = ()
    stills: tuple[StillView, ...] = ()
    links: dict[str, str] = {}


class WorkerView(View):
    """A worker's report on itself, which it sends at every heartbeat.

    job: the one that it took from the queue. jobs: all whose attempts it runs now. state: a `ready` worker
    takes jobs or has one; it takes none while it tests its device, after that has failed a test, while it
    lacks a host, while a job of another worker of its pool has its GPU (`lent`), or while GPUs are kept for a
    larger job (`kept`). problem: a sentence on that. hosts: how many machines, each with such a device, take
    a job together. pool: the GPUs of its host, its own among them, that jobs of any number share out; null:
    it has jobs on its own device alone. seats: how many jobs may share its GPU, each under a worker of its
    own; seat: which of these it is, from 0. memory_bytes: of each device, where known. packages: the optional
    packages that it has; null if a worker of an older version did not report them.
    allocation: what the cluster that started it calls the allocation it runs in: `scheduler`, `id`, `node`,
    `account`.
    """

    name: str
    host: str = ""
    pid: int = 0
    device: str = ""
    hosts: int = 1
    pool: str | None = None
    seats: int = 1
    seat: int = 0
    queues: tuple[str, ...] = ()
    job: str | None = None
    jobs: tuple[str, ...] = ()
    state: WorkerState = "ready"
    problem: str | None = None
    memory_bytes: int | None = None
    packages: tuple[str, ...] | None = None
    allocation: dict[str, str] | None = None
    started_at: datetime
    seen_at: datetime


class SlotView(View):
    """The jobs that ask the same of a worker. accelerator: `any` is one GPU or a CPU. gpus: of each host.

    queued: jobs that may begin now; running: jobs that a worker holds. oldest_queued_s: for how long the
    oldest of the queued has waited; null if none waits.
    """

    accelerator: str
    gpus: int = 0
    hosts: int = 1
    queued: int = 0
    running: int = 0
    oldest_queued_s: float | None = None


class SlotsView(View):
    """How many workers the queue wants, by kind, and of all these kinds together.

    wanted: `queued` and `running` together, the workers that have something to do.
    """

    items: tuple[SlotView, ...] = ()
    queued: int = 0
    running: int = 0
    wanted: int = 0
    oldest_queued_s: float | None = None


class ProjectUsageView(View):
    """What a user's jobs of a project have used. owner: empty in a service without accounts.

    jobs, attempts: how many ended; running: attempts that run now. seconds: of all attempts; gpu_seconds:
    those, times the GPUs that each had. queued: jobs that wait now, the oldest for oldest_queued_s since its
    submission; null if none waits. bytes: of the files of these jobs, of models and of clips, stored now.
    """

    project: str
    owner: str = ""
    jobs: int = 0
    attempts: int = 0
    running: int = 0
    seconds: float = 0.0
    gpu_seconds: float = 0.0
    queued: int = 0
    oldest_queued_s: float | None = None
    bytes: int = 0


class DeviceUsageView(View):
    """How long a device had a job. seconds: in each of the hours that `UsageView.hours` names."""

    host: str
    device: str = ""
    seconds: tuple[float, ...] = ()


class UsageView(View):
    """What was used from `since` until now. hours: the last day's, by their beginnings; the first of them and
    the present one are not whole."""

    since: datetime
    until: datetime
    projects: tuple[ProjectUsageView, ...] = ()
    hours: tuple[datetime, ...] = ()
    devices: tuple[DeviceUsageView, ...] = ()
