"""How a worker on a compute node reaches the stores: its settings, and what ssh forwards where they are not
reachable from there.

The settings lie in files of a folder that only this user reads, and that every node sees. With a tunnel they
contain the words @FOLDER@ and @PORT0@, @PORT1@, …, in whose place the batch script puts a folder and free
ports of its node.
"""

import os
import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import parse_qs, unquote, urlencode, urlsplit, urlunsplit

from core.errors import Misconfigured

FOLDER = "@FOLDER@"


@dataclass(frozen=True)
class StoresThere:
    """settings: the text of each variable. forwards: ssh's `-L` arguments. ports: how many of the node's."""

    settings: Mapping[str, str]
    forwards: tuple[str, ...] = ()
    ports: int = 0


def is_local(settings: Mapping[str, str]) -> bool:
    """Whether a store listens for this machine alone."""
    names = ("GAITWAY_DATABASE_URL", "GAITWAY_REDIS_URL", "GAITWAY_S3_ENDPOINT")
    return any(_is_local(_where(name, settings[name])) for name in names)


def through_tunnel(there: StoresThere) -> StoresThere:
    """The same through ssh. Raises Misconfigured for a store with TLS: its certificate names its host."""
    settings, forwards = dict(there.settings), list[str]()
    ports = 0

    def port_to(where: str) -> str:
        nonlocal ports
        forwards.append(f"127.0.0.1:@PORT{ports}@:{where}")
        ports += 1
        return f"@PORT{ports - 1}@"

    name = "GAITWAY_DATABASE_URL"
    where = _of_database(settings[name])
    parts = urlsplit(settings[name])
    query = {key: values[-1] for key, values in parse_qs(parts.query).items()}
    if where.startswith("/"):
        number = query.get("port") or str(parts.port or 5432)
        forwards.append(f"{FOLDER}/.s.PGSQL.{number}:{where}/.s.PGSQL.{number}")
        query |= {"host": FOLDER, "port": number}
        address = (parts.username or "") + (f":{parts.password}" if parts.password else "")
        parts = parts._replace(netloc=f"{address}@" if address else "")
    else:
        # The name stays, for the check of the certificate.
        query |= {"hostaddr": "127.0.0.1", "port": port_to(where)}
        host = parts.netloc.rpartition("@")
        parts = parts._replace(netloc="".join((*host[:2], host[2].rsplit(":", 1)[0])))
    settings[name] = urlunsplit(parts._replace(query=urlencode(query, safe="/@")))

    name = "GAITWAY_REDIS_URL"
    parts = urlsplit(settings[name])
    if parts.scheme == "unix":
        forwards.append(f"{FOLDER}/redis.sock:{unquote(parts.path)}")
        query_said = f"?{parts.query}" if parts.query else ""
        settings[name] = f"unix://{parts.netloc}{FOLDER}/redis.sock{query_said}"
    elif parts.scheme == "rediss":
        raise Misconfigured(_not_by_tunnel(name))
    else:
        port = port_to(f"{parts.hostname or 'localhost'}:{parts.port or 6379}")
        address = parts.netloc.rpartition("@")
        settings[name] = urlunsplit(parts._replace(netloc=f"{address[0]}{address[1]}127.0.0.1:{port}"))

    name = "GAITWAY_S3_ENDPOINT"
    if settings.get("GAITWAY_S3_SECURE", "true").lower() not in ("false", "0", "no", "off"):
        raise Misconfigured(_not_by_tunnel(name))
    host, _, number = settings[name].partition(":")
    settings[name] = f"127.0.0.1:{port_to(f'{host}:{number or 80}')}"
    return StoresThere(settings, tuple(forwards), ports)


def write_settings(folder: Path, settings: Mapping[str, str]) -> None:
    """A file for each, in a folder that only this user reads; what is read meanwhile is whole."""
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    folder.chmod(0o700)
    for name, value in settings.items():
        file = folder / name.lower()
        if file.is_file() and file.read_text() == value:
            continue
        partial = folder / f".{file.name}.{secrets.token_hex(4)}"
        with os.fdopen(os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as written:
            written.write(value)
        partial.replace(file)
    for left in {path.name for path in folder.iterdir()} - {name.lower() for name in settings}:
        (folder / left).unlink(missing_ok=True)


def _where(name: str, address: str) -> str:
    """The socket or HOST:PORT that the address names."""
    if name == "GAITWAY_DATABASE_URL":
        return _of_database(address)
    if name == "GAITWAY_REDIS_URL":
        parts = urlsplit(address)
        return unquote(parts.path) if parts.scheme == "unix" else f"{parts.hostname}:{parts.port or 6379}"
    return address


def _of_database(url: str) -> str:
    parts = urlsplit(url)
    query = parse_qs(parts.query)
    host = query.get("host", [unquote(parts.hostname or "localhost")])[-1]
    port = query.get("port", [str(parts.port or 5432)])[-1]
    return host if host.startswith("/") else f"{host}:{port}"


def _is_local(where: str) -> bool:
    host = where.rpartition(":")[0].strip("[]")
    return where.startswith("/") or host in ("localhost", "::1") or host.startswith("127.")


def _not_by_tunnel(name: str) -> str:
    return (
        f"{name} speaks TLS, and its certificate does not name a tunnel's end. Let the nodes reach it "
        "themselves, or name it here without TLS: ssh encrypts what it forwards."
    )
