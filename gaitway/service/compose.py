"""Commands that `docker compose` runs besides the service itself.

`python -m gaitway.service.compose setup` makes the secrets at the first start, and the files that hold them
`python -m gaitway.service.compose join`   prints the settings under which a worker on another machine joins
"""

import os
import secrets
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from gaitway.service.embedded.certificates import Certificate, authority, signed
from gaitway.service.embedded.folders import remembered, write_private
from gaitway.service.embedded.weed import REGION, weed_environment

SECRETS = Path("/run/gaitway")
# Apart from the others: PostgreSQL's container reads it as another user, and keeps the first password.
DATABASE_PASSWORD = Path("/volumes/database-password/password")

_INNER_CERTIFICATE, _INNER_KEY = "objects-inner.crt", "objects-inner.key"
# The first is for the other machines; the others are what the stores present to them.
_AUTHORITY, _STORES_CERTIFICATE, _STORES_KEY = "ca.pem", "stores.crt", "stores.key"
_JOINING = {"COMPOSE_FILE": "docker-compose.yml:deploy/own-ca.yml", "GAITWAY_TLS_CA": "/etc/gaitway/ca.pem"}
# pg_hba.conf: anyone with the password may connect, from outside the container only over TLS.
_DATABASE_RULES = """local all all scram-sha-256
host all all 127.0.0.1/32 scram-sha-256
host all all ::1/128 scram-sha-256
hostssl all all all scram-sha-256
"""
_DATABASE, _REDIS, _S3 = "GAITWAY_DATABASE_URL", "GAITWAY_REDIS_URL", "GAITWAY_S3_ENDPOINT"
# What the API hands to workers elsewhere, by what it is called there.
_FOR_WORKERS = {
    _DATABASE: "GAITWAY_WORKER_DATABASE_URL",
    _REDIS: "GAITWAY_WORKER_REDIS_URL",
    _S3: "GAITWAY_WORKER_S3_ENDPOINT",
    "GAITWAY_S3_SECURE": "GAITWAY_WORKER_S3_SECURE",
}
_WORKER_AUTHORITY = "GAITWAY_WORKER_TLS_CA"
_PASSED_ON = (
    "GAITWAY_TLS_CA",
    _DATABASE,
    _REDIS,
    "GAITWAY_REDIS_WITHOUT_PASSWORD",
    _S3,
    *(f"GAITWAY_S3_{name}" for name in ("ACCESS_KEY", "SECRET_KEY", "BUCKET", "SECURE", "REGION", "STYLE")),
)


def setup(folder: Path, environ: Mapping[str, str], database_password: Path = DATABASE_PASSWORD) -> None:
    """Fill the secrets' folder: keys, made once, and settings for the stores that the user has not named."""
    keys = _keys(folder, database_password)
    write_private(folder / "valkey.password", keys["redis_password"])
    write_private(folder / "valkey.conf", f"requirepass {keys['redis_password']}\n")
    # SeaweedFS presents it only to itself.
    inner = Certificate(*remembered(folder / "objects-inner.json", lambda: authority("gaitway-objects")))
    write_private(folder / _INNER_CERTIFICATE, inner.certificate)
    write_private(folder / _INNER_KEY, inner.key)
    write_private(folder / "objects.sh", _starting_weed(keys))
    if share := environ.get("GAITWAY_SHARE"):
        _certify(folder, database_password.parent, share)
    wanted = own_stores(keys, environ, Hosts("postgres", "valkey", "objects"))
    wanted |= _for_workers(folder, keys, environ)
    for name in (*_PASSED_ON, *_FOR_WORKERS.values(), _WORKER_AUTHORITY):
        file = folder / name.lower()
        if name in wanted:
            write_private(file, wanted[name])
        else:  # Settings that the user has named since then must not be mixed with our old values.
            file.unlink(missing_ok=True)


def _for_workers(folder: Path, keys: Mapping[str, str], environ: Mapping[str, str]) -> dict[str, str]:
    """The settings that the API hands to workers elsewhere; none unless the stores are shared at an address.

    Their user of PostgreSQL is one of its own, which the reconciler makes.
    """
    try:
        shared = _shared_address(environ.get("GAITWAY_SHARE", ""))
    except ValueError:
        return {}
    stores = own_stores(keys, environ, Hosts(shared, shared, shared), with_tls=True)
    password: str = remembered(folder / "worker-database-password.json", lambda: secrets.token_urlsafe(32))
    found = {there: stores[here] for here, there in _FOR_WORKERS.items() if here in stores}
    if _DATABASE in stores:
        at = stores[_DATABASE].rpartition("@")[2]
        found[_FOR_WORKERS[_DATABASE]] = f"postgresql://gaitway_worker:{password}@{at}"
    return {**found, _WORKER_AUTHORITY: str(SECRETS / _AUTHORITY)}


def _certify(folder: Path, database_folder: Path, address: str) -> None:
    """Write what the stores need for TLS at this address; the authority is made once."""
    by = Certificate(*remembered(folder / "authority.json", lambda: authority("gaitway")))
    write_private(folder / _AUTHORITY, by.certificate)
    stores = signed(by, [address])
    for where in (folder, database_folder):
        write_private(where / _STORES_CERTIFICATE, stores.certificate)
        write_private(where / _STORES_KEY, stores.key)
    write_private(database_folder / "pg_hba.conf", _DATABASE_RULES)
    for name in (_STORES_CERTIFICATE, _STORES_KEY, "pg_hba.conf"):
        (database_folder / name).chmod(
            0o644
        )  # Like the password: PostgreSQL's container runs as another user.


def join(
    folder: Path, environ: Mapping[str, str], database_password: Path = DATABASE_PASSWORD
) -> dict[str, str]:
    """The settings of a worker elsewhere. Raises ValueError if they would not lead it to our stores."""
    named = {name: environ[name] for name in _PASSED_ON if environ.get(name)}
    if {_DATABASE, _REDIS, _S3} <= named.keys():
        return named
    shared = _shared_address(environ.get("GAITWAY_SHARE", ""))
    own = own_stores(_keys(folder, database_password), environ, Hosts(shared, shared, shared), with_tls=True)
    return {**own, **named, **_JOINING}


class Hosts(NamedTuple):
    """The stores' host names, as seen by one client."""

    postgres: str
    valkey: str
    objects: str


def own_stores(
    keys: Mapping[str, str], environ: Mapping[str, str], hosts: Hosts, *, with_tls: bool = False
) -> dict[str, str]:
    """Settings that lead to the stores of docker-compose.yml, as far as the user has not named others."""
    found = dict[str, str]()
    scheme, verified = ("rediss", "?sslmode=verify-full") if with_tls else ("redis", "")
    if not environ.get(_DATABASE):
        login = f"gaitway:{keys['database_password']}"
        found[_DATABASE] = f"postgresql://{login}@{hosts.postgres}:5432/gaitway{verified}"
    if not environ.get(_REDIS):
        found[_REDIS] = f"{scheme}://:{keys['redis_password']}@{hosts.valkey}:6379/0"
    if not environ.get(_S3):
        found |= {
            _S3: f"{hosts.objects}:8333",
            "GAITWAY_S3_ACCESS_KEY": keys["s3_access_key"],
            "GAITWAY_S3_SECRET_KEY": keys["s3_secret_key"],
            "GAITWAY_S3_SECURE": str(with_tls).lower(),
            "GAITWAY_S3_REGION": REGION,
        }
    return found


def _shared_address(address: str) -> str:
    if not address:
        raise ValueError("GAITWAY_SHARE is not set: deploy/share.yml explains it.")
    if address in ("0.0.0.0", "::", "[::]", "127.0.0.1", "localhost"):  # noqa: S104
        raise ValueError(f"GAITWAY_SHARE={address} is not an address at which other machines reach this one.")
    return f"[{address}]" if ":" in address and not address.startswith("[") else address


def _keys(folder: Path, database_password: Path) -> dict[str, str]:
    def make() -> dict[str, str]:
        return {
            "redis_password": secrets.token_urlsafe(32),
            "s3_access_key": secrets.token_hex(10),
            "s3_secret_key": secrets.token_urlsafe(32),
            "s3_inner_key": secrets.token_hex(32),
        }

    keys: dict[str, str] = remembered(folder / "keys.json", make)
    return {**keys, "database_password": _remembered_word(database_password)}


def _remembered_word(path: Path) -> str:
    """The file's content; made at the first call, and readable by anyone who sees the volume."""
    if not path.exists():
        write_private(path, secrets.token_urlsafe(32))
        path.chmod(0o644)
    return path.read_text()


# As in `gaitway.service.embedded.weed`: after one failed write of its name index, weed writes no more, and
# logs this at each try. Once its disk has room (128 MiB), it is ended, and the container engine starts it
# again.
_ENDED_WHEN_STUCK = r"""said=$(mktemp -d)/said
mkfifo "$said"
while IFS= read -r line; do
    printf '%s\n' "$line" >&2
    case $line in
    *'write '*/filerldb2/*': '*)
        if [ "$(df -Pk . | awk 'NR == 2 { print $4 }')" -gt 131072 ]; then kill $$; fi ;;
    esac
done < "$said" &
exec "$@" 2> "$said"
"""


def _starting_weed(keys: Mapping[str, str]) -> str:
    """A script that runs its arguments as a command; no list of processes shows the keys."""
    variables = weed_environment(
        keys["s3_access_key"],
        keys["s3_secret_key"],
        lambda: keys["s3_inner_key"],
        SECRETS / _INNER_CERTIFICATE,
        SECRETS / _INNER_KEY,
    )
    lines = [f"export {name}='{value}'\n" for name, value in variables.items()]
    return "".join([*lines, _ENDED_WHEN_STUCK])


def main(arguments: Sequence[str]) -> int:
    match arguments:
        case ["setup"]:
            setup(SECRETS, os.environ)
        case ["join"]:
            try:
                settings = join(SECRETS, os.environ)
            except ValueError as error:
                sys.stderr.write(f"{error}\n")
                return 2
            # In quotes, or Compose would look for variables and comments in them.
            sys.stdout.writelines(f"{name}='{value}'\n" for name, value in settings.items())
        case _:
            sys.stderr.write(f"{__doc__}\n")
            return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
