"""The real service under the real uvicorn on a free port, over the in-memory twins of the stores."""

import hashlib
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any

import httpx
import pytest
import structlog
from fastapi import FastAPI

from api.app import create_app
from api.dependencies import Service
from api.main import Server, listen
from core.adapters.memory_jobs import MemoryJobStore
from core.adapters.memory_objects import MemoryObjectStore
from core.adapters.memory_queue import MemoryJobQueue
from core.jobs.attempts import claim
from core.jobs.job import Artifact, Job
from core.jobs.spec import JOB_SPEC
from core.jobs.status import JobStatus, Reason
from core.jobs.store import Channel, Entry
from core.settings import ApiSettings
from core.storage import keys

NOON = datetime(2026, 11, 20, 12, tzinfo=UTC)


@pytest.fixture(autouse=True)
def quiet() -> Iterator[None]:
    """No log lines among the test's own output."""
    before = structlog.get_config()
    structlog.configure(processors=[lambda *_: ""], logger_factory=structlog.ReturnLoggerFactory())
    yield
    structlog.configure(**before)


@dataclass(frozen=True)
class Stack:
    """A running service, its stores, and a client for it."""

    service: Service
    store: MemoryJobStore
    queue: MemoryJobQueue
    objects: MemoryObjectStore
    http: httpx.Client
    port: int

    def is_empty(self) -> bool:
        """Whether nothing was stored or queued."""
        return not (list(self.store.unfinished()) or list(self.objects.list("")) or self.queue.waiting())


# The twins need no address.
NOWHERE = ApiSettings(
    redis_url="unix:///unused", s3_endpoint="unused", s3_access_key="unused", s3_secret_key="unused"
)


@pytest.fixture(scope="session")
def server() -> Iterator[tuple[FastAPI, int]]:
    """The app under uvicorn, and its port. It holds nothing: each test hands it stores of its own."""
    app = create_app(NOWHERE, store=MemoryJobStore(), queue=MemoryJobQueue(), objects=MemoryObjectStore())
    with serving(app) as port:
        yield app, port


@contextmanager
def serving(app: FastAPI) -> Iterator[int]:
    """The app under uvicorn in a thread; its port."""
    server = Server(app)
    with listen("127.0.0.1", 0) as listener:
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
        thread.start()
        # The socket is listening already: a request that comes too early waits in its backlog.
        yield listener.getsockname()[1]
        server.handle_exit(15, None)
        thread.join(20)
        assert not thread.is_alive()


@pytest.fixture
def stack(server: tuple[FastAPI, int]) -> Iterator[Stack]:
    app, port = server
    store, queue, objects = MemoryJobStore(), MemoryJobQueue(), MemoryObjectStore()
    app.state.service = Service(NOWHERE, store, queue, objects)
    # Without certificates, whose loading takes longer than most tests.
    with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=20, verify=False) as http:  # noqa: S501
        yield Stack(app.state.service, store, queue, objects, http, port)
    app.state.service.stopping = True  # Whatever stream a test has left open.


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

    def __init__(self, stack: Stack, job: Job) -> None:
        self._stack = stack
        stack.store.add(job)
        claimed = claim(
            job.id,
            1,
            "worker-1",
            store=stack.store,
            objects=stack.objects,
            lease=timedelta(minutes=1),
            now=NOON,
        )
        assert claimed is not None
        self.holding = claimed
        self.id = job.id
        self.holding.start(device="cpu", engine="native", details={"cores": 2})

    def say(self, kind: str, channel: Channel = "events", **data: Any) -> None:
        self._stack.store.record(
            self.id, self.holding.token, channel, [Entry(kind=kind, time=NOON, data=data)]
        )

    def keep(self, name: str, body: bytes = ARTIFACT, **facts: Any) -> Artifact:
        """Publish a file as the supervisor does."""
        artifact = Artifact(
            name=name,
            key=keys.artifact(self.id, 1, name),
            size=len(body),
            sha256=hashlib.sha256(body).hexdigest(),
            **{"role": "video", "media_type": "video/mp4", **facts},
        )
        self._stack.objects.put(artifact.key, body, media_type=artifact.media_type)
        self.holding.publish((artifact,), keep_checkpoints=5)
        return artifact

    def end(self, status: JobStatus = JobStatus.SUCCEEDED, reason: Reason = Reason.COMPLETED) -> None:
        self.holding.end(status, reason, "It came to its end.", NOON)
