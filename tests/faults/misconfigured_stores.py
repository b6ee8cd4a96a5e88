"""Real stores that refuse in every way that a wrong setting or a full disk can bring about."""

import json
import os
import secrets
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import psycopg
import pytest

from core.adapters.postgres import schema
from core.adapters.postgres.engine import connect_postgres
from core.adapters.s3.connection import connect_s3
from core.adapters.s3.objects import S3ObjectStore
from core.adapters.wiring import connect_redis
from core.errors import StorageUnavailable
from gaitway.service.embedded import postgres as postgres_module
from gaitway.service.embedded import weed as weed_module
from gaitway.service.embedded.postgres import Postgres
from gaitway.service.embedded.processes import free_ports
from gaitway.service.embedded.valkey import Valkey
from gaitway.service.embedded.weed import REGION, Weed

SECRET = "correct-horse"


@dataclass(frozen=True)
class Stores:
    """A PostgreSQL and a Valkey with passwords, and a SeaweedFS with two ports, one for TLS.

    environment: settings that fit all of them.
    """

    environment: dict[str, str]
    postgres_port: int
    socket: str
    redis_port: int
    https_port: int
    authority: Path

    def postgres(self, login: str, database: str = "gaitway") -> str:
        return f"postgresql://{login}@127.0.0.1:{self.postgres_port}/{database}"

    def redis(self, login: str) -> str:
        return f"unix://{login}{self.socket}"


@contextmanager
def serving(folder: Path) -> Iterator[Stores]:
    """All, with users that may do everything (`all`), or only read or nothing (`reader`)."""
    https_port, redis_port, postgres_port = free_ports(3)
    folder.mkdir()
    certify(folder)
    identities = folder / "identities.json"
    identities.write_text(
        json.dumps(
            {
                "identities": [
                    _identity("all", "Admin"),
                    _identity("writer", "Read", "Write", "List"),
                    _identity("reader", "Read", "List"),
                ]
            }
        )
    )
    options = (
        f"-s3.config={identities}",
        f"-s3.port.https={https_port}",
        f"-s3.cert.file={folder / 'server.pem'}",
        f"-s3.key.file={folder / 'server.key'}",
    )
    with (
        store_with(folder / "objects", *options) as weed,
        Valkey(folder / "valkey") as valkey,
        postgres_with_passwords(folder / "postgres", postgres_port),
    ):
        with connect_redis(valkey.url) as client:
            client.acl_setuser(
                "reader", enabled=True, passwords=[f"+{SECRET}"], keys="*", categories=["+@read"]
            )
            client.config_set("bind", "0.0.0.0")  # noqa: S104 # Its protected mode is what is looked at.
            client.config_set("port", redis_port)
            client.config_set("requirepass", SECRET)
        socket = valkey.url.removeprefix("unix://")
        environment = {
            **weed.environment(),
            "GAITWAY_DATABASE_URL": f"postgresql://gaitway:{SECRET}@127.0.0.1:{postgres_port}/gaitway",
            "GAITWAY_REDIS_URL": f"unix://:{SECRET}@{socket}",
            "GAITWAY_S3_ACCESS_KEY": "all",
            "GAITWAY_S3_SECRET_KEY": SECRET,
        }
        yield Stores(environment, postgres_port, socket, redis_port, https_port, folder / "authority.pem")


@contextmanager
def store_with(folder: Path, *options: str) -> Iterator[Weed]:
    """A SeaweedFS started with these options, too."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(weed_module, "_OPTIONS", (*weed_module._OPTIONS, *options))
        weed = Weed(folder)
        if options:
            weed.access_key, weed.secret_key = "all", SECRET
        weed.start()
    try:
        yield weed
    finally:
        weed.stop()


@contextmanager
def postgres_with_passwords(folder: Path, port: int) -> Iterator[None]:
    """A PostgreSQL with its tables at a loopback port, where it wants a password."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(postgres_module, "_PORT", port)
        patch.setitem(postgres_module._OPTIONS, "port", str(port))
        patch.setitem(postgres_module._OPTIONS, "listen_addresses", "127.0.0.1")
        server = Postgres(folder, durable=True).start()
        url, admin_url = server.url, server.admin_url  # They name the port.
    try:
        schema.upgrade(connect_postgres(url, pool_size=0))
        with psycopg.connect(admin_url, autocommit=True) as admin:
            for role in ("ALTER ROLE gaitway", "CREATE ROLE reader LOGIN"):
                admin.execute(f"{role} PASSWORD '{SECRET}'")  # type: ignore[arg-type]
            access = folder / "data" / "pg_hba.conf"
            access.write_text("local all all trust\nhost all all 127.0.0.1/32 scram-sha-256\n")
            admin.execute("SELECT pg_reload_conf()")
        yield
    finally:
        server.stop()


def certify(folder: Path) -> None:
    """An authority of one's own (authority.pem), and what it signed for 127.0.0.1 (server.pem)."""
    key = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes")
    (folder / "names").write_text("subjectAltName=IP:127.0.0.1\n")
    ca = ("-keyout", "authority.key", "-out", "authority.pem", "-subj", "/CN=authority", "-days", "2")
    _openssl(folder, "req", "-x509", *key, *ca, "-addext", "keyUsage=critical,keyCertSign")
    _openssl(folder, "req", *key, "-keyout", "server.key", "-out", "server.csr", "-subj", "/CN=127.0.0.1")
    signed = ("-CA", "authority.pem", "-CAkey", "authority.key", "-CAcreateserial", "-days", "2")
    _openssl(folder, "x509", "-req", "-in", "server.csr", *signed, "-extfile", "names", "-out", "server.pem")


@contextmanager
def volume(folder: Path, size: str) -> Iterator[Path]:
    """A small volume of its own at this folder; skips where none may be mounted."""
    folder.mkdir(parents=True)
    mount = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)]
    if os.getuid() != 0 or subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("only root may mount the small volume that this test fills")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


@contextmanager
def full_object_store(folder: Path) -> Iterator[dict[str, str]]:
    """Settings that lead to a SeaweedFS on a volume without room for a byte more."""
    folder.mkdir()
    with volume(folder / "data", "6m"), store_with(folder) as weed:
        client = connect_s3(
            weed.endpoint, weed.access_key, weed.secret_key, secure=False, region=REGION, retries=0
        )
        store = S3ObjectStore(client, weed.bucket)
        for size in (2**20, 2**16, 2**12, 2**8):
            with suppress(StorageUnavailable):
                while True:
                    store.put(f"filling/{secrets.token_hex(8)}", secrets.token_bytes(size))
        yield weed.environment()


@contextmanager
def full_redis(folder: Path) -> Iterator[str]:
    """The address of a Valkey whose append-only file has no room for a byte more; ours writes none."""
    with volume(folder, "256k"), Valkey(folder) as valkey:
        with connect_redis(valkey.url) as client, suppress(Exception):
            client.config_set("appendonly", "yes")
            while True:
                client.rpush("filling", secrets.token_bytes(2**12))
        yield valkey.url


def _identity(name: str, *actions: str) -> dict[str, object]:
    key = {"accessKey": name, "secretKey": SECRET}
    return {"name": name, "credentials": [key], "actions": list(actions)}


def _openssl(folder: Path, *arguments: str) -> None:
    subprocess.run(["openssl", *arguments], cwd=folder, check=True, capture_output=True)
