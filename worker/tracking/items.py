"""The messages to the processes of this package: one JSON document per line."""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter

from core.documents import Stored

# The entries of the configuration that say what a run is about.
NAMES = ("env_name", "task_name", "algo_name")


class About(Stored):
    """The run at Weights & Biases. folder: for its files."""

    kind: Literal["about"] = "about"
    job_id: str
    project: str
    entity: str | None
    name: str
    folder: Path
    config: dict[str, Any]


class Configured(Stored):
    """More of the configuration, as an attempt has resolved it."""

    kind: Literal["config"] = "config"
    values: dict[str, Any]


class MetricsItem(Stored):
    """Metrics of a step."""

    kind: Literal["metrics"] = "metrics"
    step: int
    values: dict[str, float]


class VideoItem(Stored):
    """A video of a step; the file may be consumed. seed: whose it is, in a job of several."""

    kind: Literal["video"] = "video"
    step: int
    path: Path
    seed: int | None = None


class PolicyItem(Stored):
    """The policy of a step; the file stays as it is until the run has ended. seed: as of a video."""

    kind: Literal["policy"] = "policy"
    step: int
    path: Path
    seed: int | None = None


class EndItem(Stored):
    """Nothing more will come. exit_code: 0 if the job has done all that was asked."""

    kind: Literal["end"] = "end"
    exit_code: int


Item = Configured | MetricsItem | VideoItem | PolicyItem | EndItem
ITEM: TypeAdapter[Item] = TypeAdapter(Annotated[Item, Field(discriminator="kind")])


class WriteUp(Stored):
    """The files to write about the whole job; all paths but that of the measurements are in the folder of the
    document.

    measurements: JSON lines, each with step, time and values. events: the file for TensorBoard.
    curve: a picture, of runs that have one. archive: the offline run; None if none is wanted. films,
    policies: what it shows and has learnt; these files may be consumed.
    """

    job_id: str
    measurements: Path
    events: Path
    curve: Path
    about: About | None = None
    archive: Path | None = None
    films: list[VideoItem] = []
    policies: list[PolicyItem] = []
    exit_code: int = 0
