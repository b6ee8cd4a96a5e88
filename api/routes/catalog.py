"""The environments and algorithms that a job may name, the workers that run jobs, and how many are wanted."""

import inspect
from typing import Annotated

from fastapi import APIRouter, Path, Query
from pydantic import Field

from api.access import PrincipalDep
from api.dependencies import QueryParameters, Service, ServiceDep
from api.problems import refusals
from api.submissions import MAX_OPTIONS_LENGTH, OPTIONS_DESCRIPTION, info_under
from api.views import AlgorithmView, Listing, environment_details, environment_view, slots_view
from core.accounts.principal import Principal
from core.algorithms.catalog import ALGORITHMS
from core.bounds import LONGEST_NAME
from core.environments.catalog import ENVIRONMENTS
from core.environments.info import Device
from core.errors import EnvironmentNotFound, JobNotFound, RecordsUnavailable, Rejected
from core.jobs.slots import counted_as, wanted_slots
from core.jobs.spec import MOST_GPUS, Accelerator
from core.jobs.workers import WORKER_NAME
from gaitway.schema import EnvironmentDetails, EnvironmentView, SlotsView, WorkerView

router = APIRouter(tags=["catalog"])


@router.get("/environments")
def list_environments(
    family: Annotated[
        str | None,
        Query(
            max_length=LONGEST_NAME,
            description="`gaitway` for our own; `playground`, `brax` or a plugin for those of that package.",
        ),
    ] = None,
) -> Listing[EnvironmentView]:
    """Environments with their options, cameras and tuned hyperparameters; our own come first."""
    wanted = [info for info in ENVIRONMENTS.values() if family in (None, info.family)]
    return Listing[EnvironmentView](items=[environment_view(info) for info in wanted])


Options = Annotated[
    str | None,
    Query(
        max_length=MAX_OPTIONS_LENGTH,
        description=OPTIONS_DESCRIPTION + " The answer shows the environment under these options.",
        examples=["{}"],
    ),
]
_REFUSALS = refusals(EnvironmentNotFound, Rejected, RecordsUnavailable)


@router.get("/environments/{environment_id}", responses=_REFUSALS)
def read_environment(
    environment_id: Annotated[str, Path(max_length=LONGEST_NAME, examples=["brittle_star"])],
    service: ServiceDep,
    principal: PrincipalDep,
    options: Options = None,
) -> EnvironmentDetails:
    """One of our own environments, with the hyperparameters that a job on it gets by default."""
    return environment_details(info_under(environment_id, options, service.store, principal))


@router.get("/environments/{package}/{name}", responses=_REFUSALS)
def read_packages_environment(
    package: Annotated[str, Path(max_length=LONGEST_NAME, examples=["playground"])],
    name: Annotated[str, Path(max_length=LONGEST_NAME, examples=["CheetahRun"])],
    service: ServiceDep,
    principal: PrincipalDep,
    options: Options = None,
) -> EnvironmentDetails:
    """An environment of another package: `playground`, `brax`, or one that adds its own here."""
    return environment_details(info_under(f"{package}/{name}", options, service.store, principal))


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


class WorkerFilters(QueryParameters):
    """A part of the listing."""

    # The pattern documents; the store's own check gives a better message.
    cursor: str | None = Field(
        None,
        max_length=200,
        description="The `next` of an earlier page.",
        json_schema_extra={"pattern": f"^{WORKER_NAME}$"},
    )
    limit: int = Field(50, ge=1, le=200)


@router.get("/workers", responses=refusals(Rejected, RecordsUnavailable))
def list_workers(
    listed: Annotated[WorkerFilters, Query()], service: ServiceDep, principal: PrincipalDep
) -> Listing[WorkerView]:
    """The workers that have sent a heartbeat lately, by name; with the jobs that you may see."""
    page = service.store.list_workers(cursor=listed.cursor, limit=listed.limit)
    items = [WorkerView.model_validate(worker) for worker in page.workers]
    if not principal.is_admin:
        items = [_seen(worker, service, principal) for worker in items]
    return Listing[WorkerView](items=items, next=page.next_cursor)


def _seen(worker: WorkerView, service: Service, principal: Principal) -> WorkerView:
    """The worker without the jobs of projects that the principal does not see."""
    jobs = tuple(job for job in worker.jobs if _sees(job, service, principal))
    own = worker.job if worker.job and _sees(worker.job, service, principal) else None
    return worker.model_copy(update={"jobs": jobs, "job": own})


def _sees(job_id: str, service: Service, principal: Principal) -> bool:
    try:
        return principal.sees(service.owners.of(job_id, service.store.owner_of).project)
    except JobNotFound:  # A model that it validates, or a job that was deleted meanwhile.
        return False


class SlotFilters(QueryParameters):
    """Which jobs count, and where those count that ask for no particular device."""

    counted_as: Device | None = Field(
        None,
        description="Jobs that ask for no particular device count among those of one GPU or of a CPU: the "
        "kind that the reader starts for them. Without it, they are of the kind `any`.",
    )
    accelerator: Accelerator | None = Field(None, description="Only jobs of this kind.")
    gpus: int | None = Field(None, ge=0, le=MOST_GPUS, description="Only jobs of this many GPUs on a host.")


@router.get("/slots", responses=refusals(Rejected, RecordsUnavailable))
def read_slots(wanted: Annotated[SlotFilters, Query()], service: ServiceDep) -> SlotsView:
    """How many workers the queue wants, by kind: for what starts and stops workers.

    `queued` and `running` of the whole document are numbers even where no job fits, as scalers want them.
    """
    slots = wanted_slots(service.store.queue_counts())
    if wanted.counted_as is not None:
        slots = counted_as(slots, wanted.counted_as)
    return slots_view(
        [
            one
            for one in slots
            if wanted.accelerator in (None, one.kind.accelerator) and wanted.gpus in (None, one.kind.gpus)
        ]
    )
