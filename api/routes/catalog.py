"""The environments and algorithms that a job may name, and the workers that run jobs."""

import inspect
from typing import Annotated

from fastapi import APIRouter, Path, Query

from api.dependencies import ServiceDep
from api.problems import refusals
from api.views import AlgorithmView, EnvironmentView, Listing
from core.algorithms.catalog import ALGORITHMS
from core.environments.catalog import ENVIRONMENTS, find
from core.errors import EnvironmentNotFound, RecordsUnavailable
from core.jobs.store import WorkerInfo

router = APIRouter(tags=["catalog"])


@router.get("/environments")
def list_environments(
    family: Annotated[
        str | None,
        Query(description="`gaitway` for our own; `playground` or `brax` for those of that package."),
    ] = None,
) -> Listing[EnvironmentView]:
    """Environments with their options, cameras and tuned hyperparameters; our own come first."""
    wanted = [info for info in ENVIRONMENTS.values() if family in (None, info.family)]
    return Listing[EnvironmentView](items=[EnvironmentView.of(info) for info in wanted])


@router.get("/environments/{environment_id}", responses=refusals(EnvironmentNotFound))
def read_environment(environment_id: Annotated[str, Path(examples=["ant"])]) -> EnvironmentView:
    """One of our own environments."""
    return EnvironmentView.of(find(environment_id))


@router.get("/environments/playground/{name}", responses=refusals(EnvironmentNotFound))
def read_playground_environment(name: Annotated[str, Path(examples=["CheetahRun"])]) -> EnvironmentView:
    """One of MuJoCo Playground's environments."""
    return EnvironmentView.of(find(f"playground/{name}"))


@router.get("/environments/brax/{name}", responses=refusals(EnvironmentNotFound))
def read_brax_environment(name: Annotated[str, Path(examples=["ant"])]) -> EnvironmentView:
    """One of Brax's environments."""
    return EnvironmentView.of(find(f"brax/{name}"))


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
    """The workers that have sent a heartbeat lately."""
    return Listing[WorkerInfo](items=service.store.workers())
