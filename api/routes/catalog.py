"""What a job may name, and who would run it."""

import inspect
from typing import Annotated

from fastapi import APIRouter, Path

from api.dependencies import ServiceDep
from api.problems import refusals
from api.views import AlgorithmView, EnvironmentView, Listing
from core.algorithms.catalog import ALGORITHMS
from core.environments.catalog import ENVIRONMENTS, find
from core.errors import EnvironmentNotFound, RecordsUnavailable
from core.jobs.store import WorkerInfo

router = APIRouter(tags=["catalog"])


@router.get("/environments")
def list_environments() -> Listing[EnvironmentView]:
    """Bodies and worlds, with their options, cameras and tuned hyperparameters."""
    return Listing[EnvironmentView](items=[EnvironmentView.of(info) for info in ENVIRONMENTS.values()])


@router.get("/environments/{environment_id}", responses=refusals(EnvironmentNotFound))
def read_environment(environment_id: Annotated[str, Path(examples=["ant"])]) -> EnvironmentView:
    """One of them."""
    return EnvironmentView.of(find(environment_id))


@router.get("/algorithms")
def list_algorithms() -> Listing[AlgorithmView]:
    """Algorithms, each with the JSON Schema of its hyperparameters."""
    return Listing[AlgorithmView](
        items=[
            AlgorithmView(
                kind=kind,
                description=inspect.getdoc(row.spec) or "",
                parameters=row.spec.model_json_schema(),
            )
            for kind, row in ALGORITHMS.items()
        ]
    )


@router.get("/workers", responses=refusals(RecordsUnavailable))
def list_workers(service: ServiceDep) -> Listing[WorkerInfo]:
    """The workers that were heard of lately."""
    return Listing[WorkerInfo](items=service.store.workers())
