"""The embedded servers: private, restartable, and gone when their launcher is."""

import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from itertools import chain, repeat
from pathlib import Path

import psutil
import pytest
import urllib3

from core.adapters.startup import prepare_database
from core.adapters.wiring import connect_redis, job_store, object_store
from core.settings import WorkerSettings
from gaitway.service.embedded.processes import ServerFailed, are_free, claim, free_ports
from gaitway.service.embedded.servers import EmbeddedServers
from gaitway.service.embedded.valkey import Valkey
from gaitway.service.embedded.weed import Weed
from tests.extra import extra
from tests.unit.jobs.making import make_job

LAUNCHER = """
import sys, time
from pathlib import Path
from gaitway.service.embedded.servers import EmbeddedServers

servers = EmbeddedServers(Path(sys.argv[1])).start()
print(*(server.process.pid for server in servers.all), flush=True)
time.sleep(600)
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("stack")


@pytest.fixture(scope="module")
def servers(folder: Path) -> Iterator[EmbeddedServers]:
    with EmbeddedServers(folder) as running:
        yield running


def settings_of(servers: EmbeddedServers, monkeypatch: pytest.MonkeyPatch, data_dir: Path) -> WorkerSettings:
    for name, value in servers.environment().items():
        monkeypatch.setenv(name, value)
    return WorkerSettings(data_dir=data_dir)  # type: ignore[call-arg]


class TestTogether:
    def test_their_environment_is_all_that_settings_need(
        self, servers: EmbeddedServers, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ) -> None:
        settings = settings_of(servers, monkeypatch, tmp_path)
        prepare_database(settings)
        job = make_job()
        job_store(settings, pool_size=0).add(job)
        assert job_store(settings, pool_size=0).get(job.id) == job
        object_store(settings).put("a", b"x")
        assert object_store(settings).get("a") == b"x"

    def test_only_this_machine_reaches_them(self, servers: EmbeddedServers) -> None:
        listening = [
            connection.laddr.ip
            for server in servers.all
            for connection in psutil.Process(server.process.pid).net_connections("inet")
            if connection.status == psutil.CONN_LISTEN
        ]
        assert listening
        assert set(listening) == {"127.0.0.1"}

    def test_no_key_stands_in_an_argument_list(self, servers: EmbeddedServers) -> None:
        arguments = " ".join(psutil.Process(servers.weed.process.pid).cmdline())
        assert servers.weed.secret_key not in arguments
        assert servers.weed.access_key not in arguments

    def test_what_they_keep_is_for_one_user(self, servers: EmbeddedServers, folder: Path) -> None:
        socket_file = Path(servers.valkey.url.removeprefix("unix://"))
        for path in (folder / "valkey", folder / "objects", socket_file, folder / "objects" / "keys.json"):
            assert path.stat().st_mode & 0o077 == 0

    def test_the_inner_ports_give_nothing_without_a_key(self, servers: EmbeddedServers, folder: Path) -> None:
        # The filer behind the gateway would hand every object to every user of the machine.
        ports = json.loads((folder / "objects" / "ports.json").read_text())
        got = [
            urllib3.request("GET", f"http://127.0.0.1:{port}/buckets/", retries=False)
            for port in ports[4:8:2]
        ]
        assert [answer.status for answer in got] == [401, 401]

    def test_ctrl_c_in_a_terminal_does_not_reach_them(self, servers: EmbeddedServers) -> None:
        for server in servers.all:
            pid = server.process.pid
            assert pid is not None
            assert os.getpgid(pid) == pid

    @pytest.mark.parametrize("name", ["valkey", *extra("postgres", "weed")])
    def test_one_that_ended_is_noticed(self, name: str, tmp_path: Path) -> None:
        with EmbeddedServers(tmp_path) as running:
            running.check()
            process = getattr(running, name).process
            pid = process.pid
            assert pid is not None
            os.kill(pid, signal.SIGKILL)
            os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT)
            with pytest.raises(ServerFailed, match=f"{process.name} ended with status -9"):
                running.check()


def _without_sockets(environment: dict[str, str]) -> dict[str, str]:
    return {name: value for name, value in environment.items() if not name.endswith("_URL")}


class TestRestart:
    @pytest.mark.parametrize("ending", ["kill", *extra("stop")])
    def test_everything_acknowledged_is_there_again(
        self, ending: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ) -> None:
        job, body = make_job(), os.urandom(3 * 2**20)
        with EmbeddedServers(tmp_path / "stack") as first:
            settings = settings_of(first, monkeypatch, tmp_path)
            prepare_database(settings)
            job_store(settings, pool_size=0).add(job)
            object_store(settings).put("a/b", body)
            if ending == "kill":
                for server in first.all:
                    os.kill(server.process.pid or 0, signal.SIGKILL)
        with EmbeddedServers(tmp_path / "stack") as second:
            # A socket whose path would be too long lies in a folder that is made at each start.
            assert _without_sockets(second.environment()) == _without_sockets(first.environment())
            settings = settings_of(second, monkeypatch, tmp_path)
            assert job_store(settings, pool_size=0).get(job.id) == job
            assert object_store(settings).get("a/b") == body

    def test_the_queue_is_empty_after_a_restart(self, tmp_path: Path) -> None:
        with Valkey(tmp_path) as first, connect_redis(first.url) as client:
            client.set("waits", "1")
        with Valkey(tmp_path) as second, connect_redis(second.url) as client:
            assert client.keys() == []
            assert client.config_get("*")["maxmemory-policy"] == "noeviction"
        assert sorted(path.name for path in tmp_path.iterdir() if path.suffix == ".rdb") == []

    def test_a_port_taken_meanwhile_is_given_up(self, tmp_path: Path) -> None:
        with Weed(tmp_path) as weed:
            before = weed.endpoint
        with socket.socket() as taken:
            taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            taken.bind(("127.0.0.1", int(before.split(":")[1])))
            taken.listen()
            with Weed(tmp_path) as weed:
                assert weed.endpoint != before

    def test_a_port_taken_between_the_look_and_the_start_is_given_up(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        with socket.socket() as taken:
            taken.bind(("127.0.0.1", 0))
            blind = [taken.getsockname()[1], *free_ports(9)]
            offers = chain([blind], iter(lambda: free_ports(10), None))
            looks = chain([lambda _: []], repeat(claim))
            monkeypatch.setattr("gaitway.service.embedded.weed.free_ports", lambda _: next(offers))
            monkeypatch.setattr("gaitway.service.embedded.weed.claim", lambda ports: next(looks)(ports))
            with Weed(tmp_path) as weed:
                assert weed.endpoint != f"127.0.0.1:{blind[0]}"


class TestFailure:
    def test_two_cannot_use_one_folder(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("gaitway.service.embedded.processes.LOCK_TIMEOUT_S", 0.1)
        with Valkey(tmp_path) as first:
            with pytest.raises(ServerFailed, match="Another valkey-server uses"):
                Valkey(tmp_path).launch()
            first.process.check()

    def test_a_server_that_does_not_start_shows_its_log(self, tmp_path: Path) -> None:
        (tmp_path / "dump.rdb").write_text("nonsense\n")
        with pytest.raises(ServerFailed, match=r"ended with status 1(.|\n)*Wrong signature"):
            Valkey(tmp_path).start()

    def test_a_start_that_fails_leaves_no_process(self, tmp_path: Path) -> None:
        servers = EmbeddedServers(tmp_path)
        (tmp_path / "valkey" / "dump.rdb").write_text("nonsense\n")
        with pytest.raises(ServerFailed):
            servers.start()
        assert [server.process.pid for server in servers.all] == [None, None, None]

    def test_a_long_path_is_no_hindrance(self, tmp_path: Path) -> None:
        # A unix socket's address has room for 107 bytes.
        folder = tmp_path / ("deep " * 15) / ("é" * 40)
        with Valkey(folder) as valkey:
            assert valkey.process.pid is not None
        assert not Path(valkey.url.removeprefix("unix://")).parent.exists()

    def test_a_space_in_the_path_is_no_hindrance(self, tmp_path: Path) -> None:
        with Valkey(tmp_path / "a b%20ü") as valkey:
            valkey.process.check()
            assert valkey.process.pid is not None

    @pytest.mark.skipif(sys.platform != "linux", reason="the kernel's parent-death signal is Linux's")
    def test_they_do_not_outlive_a_launcher_that_was_killed(self, tmp_path: Path) -> None:
        with subprocess.Popen(
            [sys.executable, "-c", LAUNCHER, str(tmp_path)], stdout=subprocess.PIPE, text=True
        ) as launcher:
            assert launcher.stdout is not None
            running = [psutil.Process(int(pid)) for pid in launcher.stdout.readline().split()]
            launcher.kill()
        assert len(running) == 3
        gone, alive = psutil.wait_procs(running, timeout=5)
        assert (len(gone), alive) == (3, [])


class TestPorts:
    def test_free_ports_are_different_and_free(self) -> None:
        ports = free_ports(50)
        assert len(set(ports)) == 50
        assert are_free(ports)

    def test_a_port_with_a_listener_is_not_free(self) -> None:
        with socket.socket() as taken:
            taken.bind(("127.0.0.1", 0))
            taken.listen()
            assert not are_free([*free_ports(1), taken.getsockname()[1]])
