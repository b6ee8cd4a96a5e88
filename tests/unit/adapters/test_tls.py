"""The stores over TLS: whom our clients trust, and what they say of a certificate that they do not."""

import asyncio
import ssl
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from core.adapters.redis.errors import reaching_redis
from core.adapters.startup import exercise_objects, exercise_queue
from core.adapters.wiring import connect_redis, job_store, object_store
from core.errors import RecordsRefuse, StorageRefuses
from core.settings import StoreSettings
from gaitway.service.embedded import weed as weed_module
from gaitway.service.embedded.certificates import authority, signed
from gaitway.service.embedded.processes import free_ports
from gaitway.service.embedded.valkey import Valkey
from gaitway.service.embedded.weed import Weed
from tests.conftest import Databases

_SSL_REQUEST_BYTES = 8


@dataclass
class TlsDoor:
    """Speaks TLS for a PostgreSQL or a Valkey behind a unix socket: the wheels' own are built without it."""

    there: Path
    context: ssl.SSLContext
    asks_first: bool  # as PostgreSQL's clients do
    port: int = field(default_factory=lambda: free_ports(1)[0])

    async def accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        to_reader, to_writer = await asyncio.open_unix_connection(self.there)
        try:
            if self.asks_first:
                await reader.readexactly(_SSL_REQUEST_BYTES)
                writer.write(b"S")
                await writer.start_tls(self.context)
            await asyncio.gather(passed_on(reader, to_writer), passed_on(to_reader, writer))
        except (ConnectionError, ssl.SSLError):
            pass  # A client that does not trust us hangs up.
        finally:
            for one in (writer, to_writer):
                one.close()

    async def serve(self, open_door: Future[Callable[[], object]]) -> None:
        context = None if self.asks_first else self.context
        loop, end = asyncio.get_running_loop(), asyncio.Event()
        async with await asyncio.start_server(self.accept, "127.0.0.1", self.port, ssl=context):
            open_door.set_result(lambda: loop.call_soon_threadsafe(end.set))
            await end.wait()


async def passed_on(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    while piece := await reader.read(65_536):
        writer.write(piece)
        await writer.drain()
    writer.close()


@contextmanager
def opened(door: TlsDoor) -> Iterator[TlsDoor]:
    open_door: Future[Callable[[], object]] = Future()
    thread = threading.Thread(target=lambda: asyncio.run(door.serve(open_door)))
    thread.start()
    close = open_door.result(timeout=10)
    yield door
    close()
    thread.join()


@dataclass(frozen=True)
class Files:
    """An authority, a certificate that it signed for 127.0.0.1, and an authority that signed nothing."""

    authority: Path
    certificate: Path
    key: Path
    other: Path


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Files:
    folder = tmp_path_factory.mktemp("certificates")
    by = authority("gaitway")
    stores = signed(by, ["127.0.0.1"])
    names = ("authority.pem", "stores.crt", "stores.key", "other.pem")
    files = Files(*(folder / name for name in names))
    texts = (by.certificate, stores.certificate, stores.key, authority("gaitway").certificate)
    for name, text in zip(names, texts, strict=True):
        (folder / name).write_text(text)
    return files


@pytest.fixture(scope="module")
def addresses(
    files: Files, databases: Databases, valkey: Valkey, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[dict[str, str]]:
    """Settings of stores that speak TLS at 127.0.0.1."""
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    context.load_cert_chain(files.certificate, files.key)
    database = Path(databases.server._socket_folder) / ".s.PGSQL.5432"
    (https_port,) = free_ports(1)
    options = (
        f"-s3.port.https={https_port}",
        f"-s3.cert.file={files.certificate}",
        f"-s3.key.file={files.key}",
    )
    with ExitStack() as stack:
        postgres = stack.enter_context(opened(TlsDoor(database, context, asks_first=True)))
        socket = Path(valkey.url.removeprefix("unix://"))
        redis = stack.enter_context(opened(TlsDoor(socket, context, asks_first=False)))
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(weed_module, "_OPTIONS", (*weed_module._OPTIONS, *options))
            weed = stack.enter_context(Weed(tmp_path_factory.mktemp("weed")))
        yield {
            "database_url": databases.server.url.partition("?")[0].replace(
                "@/", f"@127.0.0.1:{postgres.port}/"
            )
            + "?sslmode=verify-full",
            "redis_url": f"rediss://127.0.0.1:{redis.port}",
            "s3_endpoint": f"127.0.0.1:{https_port}",
            "s3_access_key": weed.access_key,
            "s3_secret_key": weed.secret_key,
        }


def reach_postgresql(settings: StoreSettings) -> None:
    job_store(settings, pool_size=0).ping()


def reach_redis(settings: StoreSettings) -> None:
    with connect_redis(settings.redis_url.get_secret_value(), retries=0) as client, reaching_redis():
        exercise_queue(client)


def reach_objects(settings: StoreSettings) -> None:
    exercise_objects(object_store(settings, retries=0))


each_store = pytest.mark.parametrize("reach", [reach_postgresql, reach_redis, reach_objects])
Reach = Callable[[StoreSettings], None]


@each_store
def test_a_store_is_reached_whose_authority_is_named(
    reach: Reach, addresses: dict[str, str], files: Files
) -> None:
    reach(StoreSettings.model_validate({**addresses, "tls_ca": files.authority}))


@each_store
@pytest.mark.parametrize("named", ["nobody", "another authority"])
def test_a_certificate_of_somebody_else_is_refused(
    named: str, reach: Reach, addresses: dict[str, str], files: Files
) -> None:
    settings = {**addresses, "tls_ca": None if named == "nobody" else files.other}
    with pytest.raises((RecordsRefuse, StorageRefuses), match=r"is not trusted.*Let GAITWAY_TLS_CA name"):
        reach(StoreSettings.model_validate(settings))


@each_store
def test_a_certificate_for_another_host_is_refused(
    reach: Reach, addresses: dict[str, str], files: Files
) -> None:
    moved = {name: value.replace("127.0.0.1", "localhost") for name, value in addresses.items()}
    with pytest.raises((RecordsRefuse, StorageRefuses), match=r"is not trusted.* has to name the host"):
        reach(StoreSettings.model_validate({**moved, "tls_ca": files.authority}))
