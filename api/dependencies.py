"""What routes ask for: the service's parts, and checked parameters."""

from dataclasses import dataclass, field
from typing import Annotated

from anyio import CapacityLimiter
from fastapi import Depends, Path, Request
from pydantic import AfterValidator, BaseModel, ConfigDict

from core.jobs.job import check_job_id
from core.jobs.queue import JobQueue
from core.jobs.store import JobStore
from core.settings import ApiSettings
from core.storage.objects import ObjectStore

_WATCHING_THREADS = 16


@dataclass
class Service:
    """The parts behind the edge.

    stopping: true once the process was asked to end, so that streams close.
    watching: the threads that streams read with, apart from those that other requests share.
    """

    settings: ApiSettings
    store: JobStore
    queue: JobQueue
    objects: ObjectStore
    stopping: bool = False
    watching: CapacityLimiter = field(default_factory=lambda: CapacityLimiter(_WATCHING_THREADS))


async def _service(request: Request) -> Service:
    return request.app.state.service


# Asynchronous, so that no thread is taken for handing over a reference.
ServiceDep = Annotated[Service, Depends(_service)]
JobId = Annotated[
    str, Path(description="A job's id.", examples=["019aa3c2f0b1-5be0c1d2e3"]), AfterValidator(check_job_id)
]


class Parameters(BaseModel):
    """Parameters of a query; an unknown one is a typo and is refused."""

    model_config = ConfigDict(frozen=True, extra="forbid")
