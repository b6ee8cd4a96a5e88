"""The configuration and the name of a run at Weights & Biases: the whole specification, and flat beside it
what people filter by."""

from pathlib import Path
from typing import Any

from core.jobs.spec import TrainSpec
from worker.tracking.items import NAMES, About


def about_run(job_id: str, spec: TrainSpec, folder: Path) -> About | None:
    """The run; None if the job asks for none. folder: for its files."""
    wanted = spec.tracking.wandb
    if wanted is None:
        return None
    return About(
        job_id=job_id,
        project=wanted.project,
        entity=wanted.entity,
        name=wanted.name or spec.name or default_name(job_id, spec),
        folder=folder,
        config=as_submitted(job_id, spec),
    )


def default_name(job_id: str, spec: TrainSpec) -> str:
    """Such as `rodent_run_ppo_5be0c1d2e3`: its names, and the end of the job's id."""
    return "_".join([*_names(spec).values(), job_id.rpartition("-")[2]])


def as_submitted(job_id: str, spec: TrainSpec) -> dict[str, Any]:
    """The whole specification by its fields, and flat beside them its names and the job's id."""
    return {**_names(spec), "job": job_id, **spec.model_dump(mode="json", exclude={"tracking"})}


def as_resolved(device: str | None, engine: str | None, details: dict[str, Any]) -> dict[str, Any]:
    """An attempt's machine and hyperparameters: each flat, and all of them as `algorithm`."""
    facts = {name: value for name, value in details.items() if name != "hyperparameters"}
    facts |= {"device": device, "engine": engine}
    if "hyperparameters" not in details:
        return facts
    hyperparameters = details["hyperparameters"]
    flat = {name: value for name, value in hyperparameters.items() if name != "kind"}
    return {**flat, **facts, "algorithm": hyperparameters}


def _names(spec: TrainSpec) -> dict[str, str]:
    """The environment is body and task in one, so only a label can name the task."""
    found = (spec.environment.id, spec.labels.get("task_name"), spec.algorithm.kind)
    return {name: value for name, value in zip(NAMES, found, strict=True) if value}
