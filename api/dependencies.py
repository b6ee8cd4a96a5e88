"""Dependencies of the routes: the service's parts, and checked parameters."""

from dataclasses import dataclass, field
from typing import Annotated, Any, Protocol

from anyio import CapacityLimiter
from fastapi import Depends, Path, Request
from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from api.audit_log import AuditLog
from api.authentication import Authenticator, RequestLimit
from api.monitoring import RecentReading
from api.oidc import IdentityProvider
from api.shared_reads import JobWatcher, Owners, RecentAnswers, SharedReads, Turns
from core.accounts.store import AccountStore
from core.jobs import feeds
from core.jobs.job import JOB_ID, check_job_id
from core.jobs.queue import JobQueue
from core.jobs.store import ENTRY_ID
from core.jobs.submission import Acknowledgements
from core.settings import ApiSettings
from core.storage.objects import ObjectStore
from core.sweeps.sweep import SweepStore

_WATCHING_THREADS = 16


class ServiceStore(SweepStore, AccountStore, Protocol):
    """The whole record."""


@dataclass
class Service:
    """The parts behind the routes.

    stopping: true once the process has been asked to end; streams then close.
    watching: limits the threads that read for streams, which other requests do not share.
    watcher: tells streams when their job has changed.
    feed_reads: shares what streams read.
    lists: of jobs, as they were sent in the last moments.
    recent: reading of the record, for monitoring.
    acknowledgements: of dispatches that the queue has received.
    broken_files: keys of files that broke off as they were sent; they are read whole before the next answer.
    patient: the object store again, for a request that may take minutes; by default `objects`.
    num_uploads: models that are being received now.
    num_imports: exports that are being received or stored now.
    authenticator: finds out who makes a request; None if the service has no accounts.
    provider: where users sign in; None if there is no identity provider.
    sign_ins: counts those that fail, by address.
    turns: when the waiting jobs should start.
    owners: of the jobs and sweeps that were asked for last.
    """

    settings: ApiSettings
    store: ServiceStore
    queue: JobQueue
    objects: ObjectStore
    patient: ObjectStore | None = None
    stopping: bool = False
    broken_files: set[str] = field(default_factory=set[str])
    num_uploads: int = 0
    num_imports: int = 0
    watching: CapacityLimiter = field(default_factory=lambda: CapacityLimiter(_WATCHING_THREADS))
    watcher: JobWatcher = field(init=False)
    feed_reads: SharedReads[feeds.FeedPage | None] = field(default_factory=SharedReads[feeds.FeedPage | None])
    lists: RecentAnswers = field(default_factory=RecentAnswers)
    acknowledgements: Acknowledgements = field(init=False)
    authenticator: Authenticator | None = field(init=False)
    provider: IdentityProvider | None = field(init=False)
    sign_ins: RequestLimit = field(init=False)
    owners: Owners = field(default_factory=Owners)
    turns: Turns = field(init=False)
    audit_log: AuditLog = field(init=False)
    recent: RecentReading = field(init=False)

    def __post_init__(self) -> None:
        self.watcher = JobWatcher(self.store)
        self.turns = Turns(self.store)
        self.acknowledgements = Acknowledgements(self.store.dispatched)
        settings = self.settings
        self.authenticator = None
        if settings.accounts:
            self.authenticator = Authenticator(
                self.store, settings.requests_per_second, settings.session_idle
            )
        self.provider = None if settings.oidc_issuer is None else IdentityProvider(settings)
        sentence = "More than {most:g} sign-ins from this address have failed within a minute"
        self.sign_ins = RequestLimit(settings.sign_ins_per_minute, 60.0, 60.0, sentence)
        self.audit_log = AuditLog(self.store.note)
        self.recent = RecentReading(self.store)


async def _service(request: Request) -> Service:
    return request.app.state.service


# Asynchronous, so that returning a reference takes no thread.
ServiceDep = Annotated[Service, Depends(_service)]


async def _correlation_id(request: Request) -> str:
    return request.state.correlation_id


CorrelationId = Annotated[str, Depends(_correlation_id)]


def id_in_path(description: str) -> Any:
    """An id of a job or a sweep. The format is only documented: a validator answers a wrong one with 404."""
    return Path(
        description=description,
        examples=["019aa3c2f0b1-5be0c1d2e3"],
        json_schema_extra={"pattern": f"^{JOB_ID}$"},
    )


JobId = Annotated[str, id_in_path("A job's id."), AfterValidator(check_job_id)]
# `core.jobs.store.entry_number` checks it.
EntryId = Annotated[str, Field(json_schema_extra={"pattern": f"^{ENTRY_ID}$"})]


class QueryParameters(BaseModel):
    """Query parameters; an unknown one is a typo and is refused."""

    model_config = ConfigDict(frozen=True, extra="forbid")
