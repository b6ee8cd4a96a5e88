"""The messages to the processes of this package: one JSON document per line."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field, TypeAdapter

from core.documents import Stored

if TYPE_CHECKING:  # The processes of this package would build all specifications at each start.
    from core.jobs.spec import TrainSpec


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


class Row(Stored):
    """Metrics of a step."""

    kind: Literal["metrics"] = "metrics"
    step: int
    values: dict[str, float]


class VideoFile(Stored):
    """A video of a step; the file may be consumed."""

    kind: Literal["video"] = "video"
    step: int
    path: Path


class End(Stored):
    """Nothing more will come. exit_code: 0 if the job has done all that was asked."""

    kind: Literal["end"] = "end"
    exit_code: int


Item = Annotated[Configured | Row | VideoFile | End, Field(discriminator="kind")]
ITEM: TypeAdapter[Configured | Row | VideoFile | End] = TypeAdapter(Item)


class WriteUp(Stored):
    """The files to write about the whole job; all paths are in the folder of the document.

    measurements: JSON lines, each with step, time and values. events: the file for TensorBoard.
    curve: a picture, of runs that have one. archive: the offline run; None if none is wanted.
    """

    job_id: str
    measurements: Path
    events: Path
    curve: Path
    about: About | None = None
    archive: Path | None = None
    films: list[VideoFile] = []
    exit_code: int = 0


def about_run(job_id: str, spec: "TrainSpec", folder: Path) -> About | None:
    """The run; None if the job asks for none."""
    wanted = spec.tracking.wandb
    if wanted is None:
        return None
    name = wanted.name or spec.name or job_id
    config = spec.model_dump(mode="json", exclude={"tracking"})
    return About(
        job_id=job_id,
        project=wanted.project,
        entity=wanted.entity,
        name=name,
        folder=folder,
        config={**config, "job": job_id},
    )


def configured(device: str | None, engine: str | None, details: dict[str, Any]) -> Configured:
    """The resolved hyperparameters, and what they run on."""
    facts = {name: value for name, value in details.items() if name != "hyperparameters"}
    resolved = {"algorithm": details["hyperparameters"]} if "hyperparameters" in details else {}
    return Configured(values={**resolved, **facts, "device": device, "engine": engine})
