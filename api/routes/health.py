"""Liveness and readiness of the service."""

from contextlib import suppress

from fastapi import APIRouter

from api.dependencies import ServiceDep
from api.problems import refusals
from api.views import Health
from core.errors import ObjectNotFound, RecordsUnavailable, StorageUnavailable

router = APIRouter(tags=["health"])

_PROBE = "readiness"


@router.get("/healthz")
async def is_alive() -> Health:
    """The process answers."""
    return Health()


@router.get("/readyz", responses=refusals(RecordsUnavailable, StorageUnavailable))
def is_ready(service: ServiceDep) -> Health:
    """The job records and the object store can be reached."""
    service.store.ping()
    with suppress(ObjectNotFound):  # Any answer of the object store will do.
        service.objects.info(_PROBE)
    return Health()
