"""The real service under the real uvicorn on a free port, over the real record and twins of the rest."""

import hashlib
import secrets
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any, Generic, Literal, TypeVar

import httpx
import pytest
import structlog
from fastapi import FastAPI

from api.app import create_app
from api.dependencies import Service
from api.main import ApiServer, listen
from api.monitoring import Instruments
from core.adapters.postgres.engine import connect_postgres
from core.adapters.postgres.store import PostgresJobStore
from core.adapters.postgres.uploads import UploadQueries
from core.errors import JobFinished, RecordsUnavailable, StorageUnavailable, Unavailable
from core.jobs.attempts import claim_attempt, new_secret
from core.jobs.job import Artifact, Job
from core.jobs.spec import JOB_SPEC
from core.jobs.status import JobStatus
from core.jobs.store import Channel, Entry, JobQuery
from core.reasons import Reason
from core.settings import ApiSettings
from core.storage import keys
from tests.in_memory import MemoryJobQueue, MemoryObjectStore

NOON = datetime(2026, 11, 20, 12, tzinfo=UTC)


@pytest.fixture(autouse=True)
def quiet() -> Iterator[None]:
    """No log lines among the test's own output."""
    before = structlog.get_config()
    structlog.configure(processors=[lambda *_: ""], logger_factory=structlog.ReturnLoggerFactory())
    yield
    structlog.configure(**before)


Part = TypeVar("Part")


class Frail(Generic[Part]):
    """A part of the service that can be away for a while."""

    def __init__(self, part: Part, error: Unavailable) -> None:
        self._part = part
        self._error = error
        self._is_away = False
        self._missed = threading.Event()

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._part, name)
        if isinstance(found, UploadQueries):
            return _Uploads(self, found)
        return self.while_there(found) if callable(found) else found

    def while_there(self, call: Callable[..., Any]) -> Callable[..., Any]:
        return self._fail if self._is_away else call

    def _fail(self, *_: object, **__: object) -> None:
        self._missed.set()
        raise self._error

    @contextmanager
    def away(self) -> Iterator[threading.Event]:
        """Every call of the service fails; the event is set once one has."""
        self._missed.clear()
        self._is_away = True
        yield self._missed
        self._is_away = False


class _Uploads:
    """The records of uploads, which are away with the store that has them."""

    def __init__(self, store: "Frail[Any]", uploads: Any) -> None:
        self._store, self._uploads = store, uploads

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._uploads, name)
        return found if name == "kind" else self._store.while_there(found)


@dataclass(frozen=True)
class Stack:
    """A running service, the stores behind it, and a client for it."""

    service: Service
    store: PostgresJobStore
    queue: MemoryJobQueue
    objects: MemoryObjectStore
    http: httpx.Client
    port: int
    instruments: Instruments

    def away(self, part: Literal["store", "queue", "objects"]) -> AbstractContextManager[threading.Event]:
        """Meanwhile the service cannot reach this part, and the test can. The event: it has tried."""
        return getattr(self.service, part).away()

    def is_empty(self) -> bool:
        """Whether nothing was stored or queued."""
        stored = [*self.store.list(JobQuery()).jobs, *self.store.models.all(), *self.store.undispatched()]
        return not (stored or list(self.objects.list("")) or self.queue.waiting())


# Each test brings stores of its own, whose addresses nobody asks for.
NOWHERE = ApiSettings(
    database_url="postgresql:///unused",
    redis_url="unix:///unused",
    s3_endpoint="unused",
    s3_access_key="unused",
    s3_secret_key="unused",
)


@pytest.fixture(scope="session")
def server() -> Iterator[tuple[FastAPI, int]]:
    """The app under uvicorn, and its port. It holds nothing: each test hands it stores of its own."""
    unused = PostgresJobStore(connect_postgres(NOWHERE.database_url.get_secret_value()))
    app = create_app(NOWHERE, store=unused, queue=MemoryJobQueue(), objects=MemoryObjectStore())
    with serving(app) as port:
        yield app, port


@contextmanager
def serving(app: FastAPI, port: int = 0) -> Iterator[int]:
    """The app under uvicorn in a thread; its port, by default a free one."""
    app.state.server = server = ApiServer(app)
    with listen("127.0.0.1", port) as listener:
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
        thread.start()
        # The socket is listening already: a request that comes too early waits in its backlog.
        yield listener.getsockname()[1]
        server.handle_exit(15, None)
        thread.join(20)
        assert not thread.is_alive()


@pytest.fixture
def stack(server: tuple[FastAPI, int], job_store: PostgresJobStore) -> Iterator[Stack]:
    app, port = server
    queue, objects = MemoryJobQueue(), MemoryObjectStore()
    app.state.service = service = Service(
        NOWHERE,
        Frail(job_store, RecordsUnavailable("PostgreSQL does not answer.", retry_after_s=7)),
        Frail(queue, RecordsUnavailable("Redis does not answer.")),
        Frail(objects, StorageUnavailable("The object store does not answer.")),
    )
    # Without certificates, whose loading takes longer than most tests.
    with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=20, verify=False) as http:  # noqa: S501
        yield Stack(service, job_store, queue, objects, http, port, app.state.instruments)
    service.acknowledgements.flush()
    service.stopping = True  # Whatever stream a test has left open.
    # A request that outlived its stores would return its connection to a pool that nobody closes any more.
    requests = app.state.server.server_state.tasks
    until = time.monotonic() + 10
    while (service.watcher.is_looking or requests) and time.monotonic() < until:
        time.sleep(0.01)
    assert not service.watcher.is_looking
    assert not requests


@pytest.fixture
def http(stack: Stack) -> httpx.Client:
    return stack.http


ARTIFACT = bytes(range(256)) * 8192  # 2 MiB: three pieces of at most 1 MiB would be needed for one byte more.


def job(job_id: str = "019aa3c2f0b1-5be0c1d2e3", **spec: Any) -> Job:
    """A queued training of the ant."""
    document = {"kind": "train", "environment": {"id": "ant"}, **spec}
    return Job(id=job_id, spec=JOB_SPEC.validate_python(document), created_at=NOON)


class Attempt:
    """A worker's part, played by a test."""

    def __init__(self, stack: Stack, job: Job, *, is_new: bool = True, worker: str = "worker-1") -> None:
        self._stack = stack
        if is_new:
            stack.store.add(job)
        claimed = claim_attempt(
            job.id,
            1,
            worker,
            store=stack.store,
            objects=stack.objects,
            lease=timedelta(minutes=1),
            secret=new_secret(),
        )
        if claimed is None:
            raise JobFinished(f"Job {job.id} has been cancelled.")
        self.claim = claimed
        self.id = job.id
        self.claim.start(device="cpu", engine="native", details={"cores": 2})

    def say(self, kind: str, **data: Any) -> None:
        self._record("events", Entry(kind=kind, time=NOON, data=data))

    def say_all(self, kind: str, said: Sequence[dict[str, Any]]) -> None:
        """Many entries of one kind, in one write."""
        self._record("events", *(Entry(kind=kind, time=NOON, data=data) for data in said))

    def print(self, *lines: str) -> None:
        """Lines of the log, in one write."""
        self._record("logs", *(Entry(kind="line", time=NOON, data={"text": line}) for line in lines))

    def _record(self, channel: Channel, *entries: Entry) -> None:
        self._stack.store.record(self.id, self.claim.token, channel, entries, write_id=secrets.token_hex(8))

    def keep(self, name: str, body: bytes = ARTIFACT, **facts: Any) -> Artifact:
        """Publish a file as the supervisor does."""
        digest = hashlib.sha256(body).hexdigest()
        artifact = Artifact(
            name=name,
            key=keys.artifact(self.id, 1, digest, name),
            size=len(body),
            sha256=digest,
            **{"role": "video", "media_type": "video/mp4", **facts},
        )
        self._stack.objects.put(artifact.key, body, media_type=artifact.media_type)
        self.claim.publish((artifact,), keep_checkpoints=5)
        return artifact

    def end(self, status: JobStatus = JobStatus.SUCCEEDED, reason: Reason = Reason.COMPLETED) -> None:
        self.claim.end(status, reason, "It came to its end.")


@pytest.fixture
def exported(stack: Stack) -> bytes:
    """The export of a job that succeeded, and of which this service then keeps nothing."""
    from tests.api.exports import trained

    attempt = trained(stack)
    attempt.end()
    archive = stack.http.get(f"/jobs/{attempt.id}/export").content
    assert stack.http.delete(f"/jobs/{attempt.id}").status_code == 204
    assert stack.is_empty()
    return archive
