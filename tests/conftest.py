"""Real servers for the tests, one of each per process of the test run, empty for every test."""

import os
import secrets
import shutil
import signal
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psycopg
import pytest
import redis

from core.adapters.postgres import schema
from core.adapters.postgres.engine import connect_postgres
from core.adapters.postgres.store import PostgresJobStore
from core.adapters.rq.queue import RQQueue
from core.adapters.s3.connection import connect_s3
from core.adapters.s3.objects import S3ObjectStore
from core.adapters.wiring import connect_redis
from core.jobs.queue import JobQueue
from core.jobs.store import JobStore
from core.settings import WorkerSettings
from core.storage.objects import ObjectStore
from gaitway.service.embedded.postgres import Postgres
from gaitway.service.embedded.valkey import Valkey
from gaitway.service.embedded.weed import REGION, Weed
from tests.compiling import compile_quickly, compiling_quickly, lower_in_one_context
from tests.in_memory import MemoryJobQueue, MemoryObjectStore
from tests.kept_programs import forget_old_programs, keep_programs
from tests.memory_folder import memory_folder

pytest_plugins = ["tests.durations", "tests.hypothesis_profiles", "tests.order"]


def pytest_configure(config: pytest.Config) -> None:
    """Long tests run long enough to be compiled well; idle workers compile nothing beside the tests."""
    os.environ.setdefault("GAITWAY_PREPARE", "")
    if "not slow" in config.option.markexpr or config.option.markexpr == "extra":
        compile_quickly()
    lower_in_one_context()
    keep_programs()
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        # A shell's background job ignores it, and so would all that the tests start and end by it.
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_unconfigure(config: pytest.Config) -> None:
    if not hasattr(config, "workerinput"):
        forget_old_programs()


@pytest.fixture(scope="session", autouse=True)
def own_data_home(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Services of the tests leave their addresses apart from those that this machine's user has started."""
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("XDG_DATA_HOME", str(tmp_path_factory.mktemp("data_home")))
        yield


@pytest.fixture
def compiled_quickly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Processes that this test starts compile as the test does, and not as users have it."""
    for name, value in compiling_quickly().items():
        monkeypatch.setenv(name, value)


@pytest.fixture
def without_rank_promotion() -> Iterator[None]:
    """Arrays of different ranks are not broadcast. Not for MJX or Brax, which rely on it themselves."""
    import jax

    with jax.numpy_rank_promotion("raise"):
        yield


@dataclass(frozen=True)
class Databases:
    """A running PostgreSQL with a template that has the tables; each test gets a copy of it."""

    server: Postgres
    admin: psycopg.Connection[Any]

    def fresh(self) -> str:
        """The address of a new database with empty tables."""
        name = f"test_{secrets.token_hex(6)}"
        self.admin.execute(f"CREATE DATABASE {name} TEMPLATE gaitway")
        return self.server.admin_url.replace("/gaitway?", f"/{name}?")

    def drop(self, url: str) -> None:
        name = url.partition("?")[0].rpartition("/")[2]
        self.admin.execute(f"DROP DATABASE IF EXISTS {name} WITH (FORCE)")


@pytest.fixture(scope="session")
def servers_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Where the servers of this process of the test run keep what they store."""
    with memory_folder(otherwise=tmp_path_factory.mktemp("servers")) as folder:
        yield folder


@pytest.fixture(scope="session")
def postgres_data(servers_folder: Path) -> Path:
    """The folder of a PostgreSQL after its first start, to be copied: making it takes a second."""
    with Postgres(servers_folder / "first_postgres", durable=False):
        pass
    return servers_folder / "first_postgres" / "data"


@pytest.fixture(scope="session")
def databases(servers_folder: Path, postgres_data: Path) -> Iterator[Databases]:
    """A running PostgreSQL; tests take `job_store`, `database_url` or `settings`."""
    shutil.copytree(postgres_data, servers_folder / "postgres" / "data")
    with Postgres(servers_folder / "postgres", durable=False) as server:
        schema.upgrade(connect_postgres(server.url, pool_size=0))
        maintenance = server.admin_url.replace("/gaitway?", "/postgres?")
        with psycopg.connect(maintenance, autocommit=True) as admin:
            yield Databases(server, admin)


@pytest.fixture
def database_url(databases: Databases) -> Iterator[str]:
    """The address of a database with empty tables."""
    url = databases.fresh()
    yield url
    databases.drop(url)


@pytest.fixture
def job_store(database_url: str) -> Iterator[PostgresJobStore]:
    """The record, empty."""
    store = PostgresJobStore(connect_postgres(database_url))
    yield store
    store.close()


@pytest.fixture(scope="session")
def valkey(servers_folder: Path) -> Iterator[Valkey]:
    """A running Valkey; tests take `redis_client`, or `settings`, to find it empty."""
    with Valkey(servers_folder / "valkey") as server:
        yield server


@pytest.fixture(scope="session")
def weed(servers_folder: Path) -> Iterator[Weed]:
    """A running object store; tests take `object_store`, or `settings`, to find it empty."""
    with Weed(servers_folder / "weed") as server:
        yield server


@pytest.fixture
def redis_client(valkey: Valkey) -> Iterator[redis.Redis]:
    """A client of an empty Valkey."""
    with connect_redis(valkey.url) as client:
        client.flushall()
        yield client


@pytest.fixture
def object_store(weed: Weed) -> S3ObjectStore:
    """The real object store, empty."""
    client = connect_s3(weed.endpoint, weed.access_key, weed.secret_key, secure=False, region=REGION)
    store = S3ObjectStore(client, weed.bucket)
    store.delete_prefix("")
    return store


@pytest.fixture
def settings(
    database_url: str,
    valkey: Valkey,
    weed: Weed,
    redis_client: redis.Redis,
    object_store: S3ObjectStore,
    tmp_path: Path,
) -> WorkerSettings:
    """WorkerSettings that lead to the three servers, all empty, and to an empty data folder."""
    return WorkerSettings.model_validate(
        {
            "database_url": database_url,
            "redis_url": valkey.url,
            "s3_endpoint": weed.endpoint,
            "s3_access_key": weed.access_key,
            "s3_secret_key": weed.secret_key,
            "s3_bucket": weed.bucket,
            "s3_secure": False,
            "s3_region": REGION,
            "data_dir": tmp_path / "data",
        }
    )


@pytest.fixture
def jobs(job_store: PostgresJobStore) -> JobStore:
    """The record by its seam, empty."""
    return job_store


@pytest.fixture(params=["memory", "rq"])
def queue(request: pytest.FixtureRequest) -> JobQueue:
    """Each job queue in turn, empty."""
    if request.param == "memory":
        return MemoryJobQueue()
    return RQQueue(request.getfixturevalue("redis_client"))


@pytest.fixture(params=["memory", "s3"])
def objects(request: pytest.FixtureRequest) -> ObjectStore:
    """Each object store in turn, empty."""
    if request.param == "memory":
        return MemoryObjectStore()
    return request.getfixturevalue("object_store")
