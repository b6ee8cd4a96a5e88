"""Which sentence each refusal of a real PostgreSQL becomes."""

import re
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import cast
from urllib.parse import quote

import psycopg
import pytest
from sqlalchemy.exc import DBAPIError

from core.adapters.postgres import schema
from core.adapters.postgres.engine import DEADLINE_S, PromptConnection, connect_postgres
from core.adapters.postgres.errors import Breaker, NoAnswer
from core.adapters.postgres.store import PostgresJobStore
from core.errors import Misconfigured, RecordsRefuse, RecordsUnavailable
from gaitway.service.embedded.postgres import Postgres

PASSWORD = "its/se#cret@words"


class Server:
    """A PostgreSQL whose access rules a test may change."""

    def __init__(self, server: Postgres) -> None:
        self.url = server.admin_url
        self._rules = Path(self.do("SHOW hba_file"))
        self._first_rules = "local all all trust\n"
        self._rule(self._first_rules)

    def do(self, statement: str) -> str:
        """As its owner; the first thing that it answers."""
        with psycopg.connect(self.url, autocommit=True) as connection:
            done = connection.execute(statement.encode())
            row = done.fetchone() if done.description else None
            return "" if row is None else row[0]

    def as_user(self, user: str, password: str = "") -> str:
        """The address for somebody else."""
        said = f"{user}:{quote(password, safe='')}" if password else user
        return re.sub("//[^@]*@", f"//{said}@", self.url)

    @contextmanager
    def ruled(self, *rules: str) -> Iterator[None]:
        """These rules go before its owner's, and others are not let in."""
        self._rule("\n".join([*rules, "local all gaitway trust", ""]))
        yield
        self._rule(self._first_rules)

    def _rule(self, rules: str) -> None:
        self._rules.write_text(rules)
        before = self.do("SELECT pg_conf_load_time()")
        self.do("SELECT pg_reload_conf()")
        until = time.monotonic() + 10
        # It answers before it has read them.
        while self.do("SELECT pg_conf_load_time()") == before and time.monotonic() < until:
            time.sleep(0.01)

    @contextmanager
    def allowed(self, right: str) -> Iterator[None]:
        """The guest may do this."""
        self.do(f"GRANT {right} TO guest")
        yield
        self.do(f"REVOKE {right} FROM guest")

    @contextmanager
    def limited(self, limit: str) -> Iterator[None]:
        """This holds for the guest."""
        self.do(f"ALTER ROLE guest {limit}")
        yield
        self.do("ALTER ROLE guest RESET ALL")
        self.do("ALTER ROLE guest CONNECTION LIMIT -1")


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """With a user `guest`, who has a password and no rights."""
    with Postgres(tmp_path_factory.mktemp("postgres"), durable=False) as started:
        schema.upgrade(connect_postgres(started.url, pool_size=0))
        server = Server(started)
        server.do(f"CREATE ROLE guest LOGIN PASSWORD '{PASSWORD}'")
        yield server


@contextmanager
def answering(answer: bytes) -> Iterator[str]:
    """The address of a server that says this to whoever comes, whatever it is asked, and hangs up."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        done = threading.Event()

        def serve() -> None:
            listener.settimeout(0.05)
            while not done.is_set():
                try:
                    connection, _ = listener.accept()
                except TimeoutError:
                    continue
                with connection:
                    connection.recv(4096)
                    connection.sendall(answer)

        thread = threading.Thread(target=serve)
        thread.start()
        yield f"postgresql://gaitway@127.0.0.1:{listener.getsockname()[1]}/gaitway"
        done.set()
        thread.join()


def ping(url: str) -> None:
    PostgresJobStore(connect_postgres(url, pool_size=0)).ping()


def refused(words: str, url: str, call: Callable[[str], None] = ping) -> None:
    """A setting has to change, and nothing shows the password."""
    with pytest.raises(RecordsRefuse, match=words) as caught:
        call(url)
    assert "secret" not in caught.value.detail
    assert "cret@" not in caught.value.detail


def unavailable(words: str, url: str, call: Callable[[str], None] = ping) -> None:
    """It may pass with time."""
    with pytest.raises(RecordsUnavailable, match=words) as caught:
        call(url)
    assert not isinstance(caught.value, RecordsRefuse)


class TestAccess:
    def test_who_is_let_in_may_ping(self, server: Server) -> None:
        ping(server.url)

    def test_a_wrong_password_is_named_and_not_shown(self, server: Server) -> None:
        with server.ruled("local all guest scram-sha-256"):
            refused("user or the password in GAITWAY_DATABASE_URL", server.as_user("guest", "not/secret@"))

    def test_the_right_password_with_every_awkward_character_is_read(self, server: Server) -> None:
        with server.ruled("local all guest scram-sha-256"):
            refused("may not use these tables", server.as_user("guest", PASSWORD))

    def test_a_missing_password_is_named(self, server: Server) -> None:
        with server.ruled("local all guest scram-sha-256"):
            refused("has no password and that PostgreSQL wants one", server.as_user("guest"))

    def test_a_user_that_is_not_there_is_named(self, server: Server) -> None:
        refused("no user with the name in GAITWAY_DATABASE_URL", server.as_user("nobody"))

    def test_a_user_of_another_account_is_told_so(self, server: Server) -> None:
        with server.ruled("local all guest peer"):
            refused("only from the system account", server.as_user("guest"))

    def test_a_user_whom_no_rule_lets_in_is_told_of_the_rules(self, server: Server) -> None:
        with server.ruled():
            refused("add a line to its pg_hba.conf", server.as_user("guest"))

    def test_a_database_that_is_not_there_is_named(self, server: Server) -> None:
        refused("no database with the name at the end", server.url.replace("/gaitway?", "/nowhere?"))

    def test_a_user_without_rights_is_told_what_to_do(self, server: Server) -> None:
        refused("make it the owner of the database", server.as_user("guest"))

    def test_a_server_that_takes_no_writes_is_called_a_standby(self, server: Server) -> None:
        with server.allowed("ALL ON workers"), server.limited("SET default_transaction_read_only = on"):
            refused("leads to a standby", server.as_user("guest"), run("DELETE FROM workers"))

    @pytest.mark.parametrize(
        "statement", ["EXECUTE prepared_elsewhere", "PREPARE twice AS SELECT 1; PREPARE twice AS SELECT 1"]
    )
    def test_a_pooler_that_changes_servers_within_a_session_is_named(
        self, server: Server, statement: str
    ) -> None:
        refused("let it work by sessions", server.url, run(statement))

    def test_a_user_with_no_connection_left_waits_for_one(self, server: Server) -> None:
        url = server.as_user("guest")
        with psycopg.connect(url), server.limited("CONNECTION LIMIT 1"):
            unavailable("no connection left: raise its max_connections", url)


class TestTables:
    @pytest.fixture
    def elsewhere(self, server: Server) -> Iterator[str]:
        """The address of a database without tables."""
        server.do("CREATE DATABASE elsewhere")
        yield server.url.replace("/gaitway?", "/elsewhere?")
        server.do("DROP DATABASE elsewhere WITH (FORCE)")

    def test_a_database_without_tables_waits_for_the_reconciler(self, elsewhere: str) -> None:
        unavailable("no tables yet: the reconciler makes them", elsewhere)

    def test_tables_of_another_version_wait_for_the_reconciler(self, elsewhere: str) -> None:
        schema.upgrade(connect_postgres(elsewhere, pool_size=0))
        with psycopg.connect(elsewhere, autocommit=True) as connection:
            connection.execute("ALTER TABLE pulse RENAME COLUMN id TO later")
        unavailable("another version's tables: the reconciler upgrades them", elsewhere)

    @pytest.fixture
    def patient(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """A client that waits for the server's word: on a busy machine that comes after its deadline."""
        monkeypatch.setattr(PromptConnection, "deadline_s", 30.0)

    @pytest.mark.usefixtures("patient")
    def test_a_lock_that_somebody_keeps_is_waited_for_a_while(self, server: Server) -> None:
        assert DEADLINE_S > 1.5
        with psycopg.connect(server.url) as connection:
            connection.execute("LOCK TABLE pulse")
            begun = time.monotonic()
            unavailable(r"waited for a lock for longer than 1\.5 s", server.url)
            assert time.monotonic() - begun < 5

    @pytest.mark.usefixtures("patient")
    def test_a_statement_that_takes_too_long_is_ended_by_the_server(self, server: Server) -> None:
        assert DEADLINE_S > 1.8
        unavailable(r"took longer than 1\.8 s; it is overloaded", server.url, run("SELECT pg_sleep(5)"))

    def test_a_connection_in_use_at_the_close_is_closed_when_it_comes_back(self, server: Server) -> None:
        engine = connect_postgres(server.url)
        with engine.connect() as connection:
            driver = cast("PromptConnection", connection.connection.driver_connection)
            engine.dispose()
        assert driver.closed

    def test_our_own_mistakes_pass_through(self, server: Server) -> None:
        with pytest.raises(DBAPIError, match="syntax error"):
            run("SELEKT 1")(server.url)


def run(statement: str) -> Callable[[str], None]:
    def call(url: str) -> None:
        with Breaker().reaching(), connect_postgres(url, pool_size=0).connect() as connection:
            connection.exec_driver_sql(statement)

    return call


class TestAddresses:
    def test_nobody_there_is_an_outage_with_its_reason(self, tmp_path: Path) -> None:
        host = quote(str(tmp_path), safe="")
        unavailable(
            r"does not answer at GAITWAY_DATABASE_URL: No such file or directory\. Start it, or correct",
            f"postgresql://gaitway@/gaitway?host={host}",
        )
        with socket.create_server(("127.0.0.1", 0)) as listener:
            port = listener.getsockname()[1]
        unavailable(
            r"GAITWAY_DATABASE_URL: Connection refused\. Start it, or correct the setting\.",
            f"postgresql://gaitway@127.0.0.1:{port}/gaitway",
        )

    def test_a_host_without_an_address_is_an_outage_that_names_it(self) -> None:
        unavailable(
            r"failed to resolve host 'nowhere\.invalid'", "postgresql://gaitway@nowhere.invalid/gaitway"
        )

    def test_one_who_hangs_up_is_an_outage(self) -> None:
        with answering(b"") as url:
            unavailable(r"URL: server closed the connection unexpectedly\. Start it", url)

    @pytest.mark.parametrize("mode", ["prefer", "disable", "require"])
    def test_what_is_no_postgresql_is_refused(self, mode: str) -> None:
        with answering(b"HTTP/1.1 400 Bad Request\r\n\r\n") as url:
            refused("is not PostgreSQL: correct its host and port", f"{url}?sslmode={mode}")

    def test_tls_asked_of_a_postgresql_without_it_is_named(self) -> None:
        with answering(b"N") as url:  # Its whole answer to the question for TLS.
            refused("asks for TLS, which that PostgreSQL does not offer", f"{url}?sslmode=require")

    def test_one_who_says_nothing_is_waited_for_two_seconds(self) -> None:
        with socket.create_server(("127.0.0.1", 0)) as silent:
            begun = time.monotonic()
            unavailable(
                "does not answer at GAITWAY_DATABASE_URL: connection timeout expired",
                f"postgresql://gaitway@127.0.0.1:{silent.getsockname()[1]}/gaitway",
            )
            assert time.monotonic() - begun < 3.8

    @pytest.mark.parametrize(
        "url",
        [
            "postgresql://user:se/cret@host/db",
            "postgresql://user:1/secret@host/db",
            "postgresql://user:its@secret@host/db",
            "postgresql://user:secret%@host/db",
            "postgresql://user:secret%zz@host/db",
            "postgresql://user:secret%00@host/db",
            "postgresql://user:secret@host:port/db",
            "postgresql://user:secret@host:99999/db",
            "postgresql://user:secret@host:0/db",
            "postgresql://user:secret@host/db?secret",
            "postgresql://user:secret@host/db?secret=1",
            "postgresql://user:secret@[::1/db",
            "secret",
        ],
    )
    def test_one_that_cannot_be_read_is_refused_without_showing_a_piece_of_its_password(
        self, url: str
    ) -> None:
        with pytest.raises(Misconfigured, match="GAITWAY_DATABASE_URL cannot be read") as caught:
            connect_postgres(url)
        assert not re.search("se/|cret|its", caught.value.detail)

    @pytest.mark.parametrize(
        "url",
        [
            "postgresql://user:its%2Fse%23cret%40words@host:5432/db?sslmode=verify-full",
            "postgresql://user:se#cret?@host/db",
            "postgresql://user@/db?host=%2Ftmp%2Fa%20folder",
            "postgresql://one:5432,two:5433/db?target_session_attrs=read-write",
            "postgresql://user@[::1]:5432/db",
            "postgres://host/db",
        ],
    )
    def test_one_that_can_be_read_is_taken_before_anything_is_asked_there(self, url: str) -> None:
        connect_postgres(url).dispose()


def test_silence_after_a_large_call_refuses_no_other() -> None:
    """M4: one wide import made every request of its process wait for a second, again and again."""
    breaker = Breaker()
    with pytest.raises(RecordsUnavailable), breaker.reaching(is_large=True):
        raise NoAnswer("no answer within 2 s")
    with breaker.reaching():
        pass
    with pytest.raises(RecordsUnavailable), breaker.reaching():
        raise NoAnswer("no answer within 2 s")
    with pytest.raises(RecordsUnavailable), breaker.reaching():
        pytest.fail("It was called.")
