"""The stack as a user starts it: it comes up, tells, mends itself, and leaves nothing behind."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import httpx
import psutil
import psycopg
import pytest

from core.adapters.postgres import schema
from core.adapters.postgres.engine import connect_postgres
from gaitway.service.embedded.postgres import Postgres
from gaitway.service.embedded.processes import free_ports
from tests.extra import extra

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="looks for processes in /proc")

MARK = "GAITWAY_TEST_STACK"
DATA = "data with a space"
# No worker here has a GPU, so it stays in the queue.
WAITS_FOR_A_GPU = {"environment": "ant", "kind": "train", "resources": {"accelerator": "gpu"}}


@dataclass(frozen=True)
class Launched:
    """A launcher under test; `mark` is in the environment of whatever comes from it."""

    process: subprocess.Popen[str]
    data: Path
    mark: str

    def family(self) -> list[psutil.Process]:
        """Every living process of this stack, by its environment or its data folder.

        weed and postgres have environments of their own; valkey writes over its environment and arguments,
        and stands in its part of the folder, as postgres does.
        """
        return [process for process in psutil.process_iter() if self._is_ours(process)]

    def named(self, part: str) -> list[psutil.Process]:
        return [process for process in self.family() if part in " ".join(process.cmdline())]

    def url(self) -> str:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        found = re.search(r"http://127\.0\.0\.1:\d+", line)
        assert found is not None, (line, self.process.communicate())
        return found[0]

    def _is_ours(self, process: psutil.Process) -> bool:
        try:
            if process.pid == os.getpid() or process.status() == psutil.STATUS_ZOMBIE:
                return False
            traces = (" ".join(process.cmdline()), process.cwd())
            return process.environ().get(MARK) == self.mark or any(str(self.data) in t for t in traces)
        except (psutil.NoSuchProcess, psutil.AccessDenied):
            return False


Launch = Callable[..., Launched]


@pytest.fixture
def launch(tmp_path: Path) -> Iterator[Launch]:
    launched: list[Launched] = []

    def start(*arguments: str) -> Launched:
        mark = uuid.uuid4().hex
        data = tmp_path / DATA
        command = [sys.executable, "-P", "-m", "gaitway.service.embedded.up", "--data", str(data), *arguments]
        process = subprocess.Popen(
            command,
            cwd=tmp_path,
            env={**os.environ, MARK: mark},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        launched.append(Launched(process, data, mark))
        return launched[-1]

    yield start
    for one in launched:
        one.process.kill()
        one.process.communicate()
        for left in one.family():
            with suppress(psutil.NoSuchProcess):  # It may end by itself meanwhile.
                left.kill()


def eventually(holds: Callable[[], bool], within_s: float) -> bool:
    deadline = time.monotonic() + within_s
    while time.monotonic() < deadline:
        if holds():
            return True
        time.sleep(0.05)
    return holds()


def test_the_stack_serves_has_its_workers_and_ends_with_nothing_left(launch: Launch) -> None:
    stack = launch("--workers", "2")
    url = stack.url()
    assert httpx.get(f"{url}/readyz").status_code == 200
    assert eventually(lambda: len(httpx.get(f"{url}/workers").json()["items"]) == 2, 20)
    # Launcher, postgres, valkey, weed, reconciler, API and two workers, at least.
    assert eventually(lambda: len(stack.family()) >= 8, 5)
    stack.process.send_signal(signal.SIGINT)
    _, told = stack.process.communicate(timeout=30)
    assert stack.process.returncode == 0, told
    assert "Ending" in told
    assert stack.family() == []


@pytest.mark.extra
def test_the_stack_serves_with_several_processes_of_the_api(
    launch: Launch, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GAITWAY_API_PROCESSES", "2")
    stack = launch()
    url = stack.url()
    assert httpx.get(f"{url}/readyz").status_code == 200
    # The one that the stack started, and the two that answer.
    assert eventually(lambda: len(_of_the_api(stack)) == 3, 10)
    stack.process.send_signal(signal.SIGINT)
    _, told = stack.process.communicate(timeout=30)
    assert stack.process.returncode == 0, told
    assert stack.family() == []


@pytest.mark.parametrize(
    ("seconds", "number"),
    [(1.2, signal.SIGTERM), *extra((0.6, signal.SIGINT), (2.0, signal.SIGHUP))],
)
def test_a_signal_while_it_starts_leaves_nothing(launch: Launch, seconds: float, number: int) -> None:
    stack = launch()
    # Real time on purpose: the moments shall be spread over the whole start.
    time.sleep(seconds)
    stack.process.send_signal(number)
    stack.process.communicate(timeout=30)
    assert stack.process.returncode in (0, 128 + number, -number)
    assert stack.family() == []


def test_what_ends_is_started_again_and_named(launch: Launch) -> None:
    stack = launch()
    url = stack.url()
    job = httpx.post(f"{url}/jobs", json=WAITS_FOR_A_GPU).json()
    for one in (*stack.named("-m api"), *stack.named("postgres -D"), *stack.named("valkey-server")):
        one.kill()
    assert eventually(lambda: _is_ready(url), 20)
    # Which workers are there is another matter.
    assert httpx.get(f"{url}/jobs/{job['id']}").json() | {"waiting_for": None} == job | {"waiting_for": None}
    [weed] = stack.named("weed mini")
    assert eventually(lambda: _says_that_its_disk_was_full(stack) and not weed.is_running(), 20)
    assert eventually(lambda: len(stack.named("weed mini")) == 1, 20)
    stack.process.send_signal(signal.SIGINT)
    _, told = stack.process.communicate(timeout=30)
    for name in ("api", "postgres", "valkey-server"):
        assert f"{name} has ended unexpectedly and is started again" in told
    assert "weed" not in re.findall(r"(\S+) has ended unexpectedly", told)
    assert "A write of weed failed" in told


def test_a_port_in_use_is_refused_before_anything_starts(launch: Launch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        stack = launch("--port", str(port))
        _, told = stack.process.communicate(timeout=30)
    assert stack.process.returncode == 1
    assert f"Port {port} is in use" in told
    assert not stack.data.exists()


@pytest.mark.extra
def test_no_server_takes_the_port_of_the_api(launch: Launch, tmp_path: Path) -> None:
    """Filers answer at /readyz, too: with one at this port, the stack would seem to be up without its API."""
    ports = free_ports(10)
    objects = tmp_path / DATA / "objects"
    objects.mkdir(parents=True)
    (objects / "ports.json").write_text(json.dumps(ports))  # As if weed had had them in the last run.
    url = launch("--port", str(ports[6])).url()
    assert httpx.get(f"{url}/readyz").json() == {"status": "ok"}


def test_a_second_stack_on_the_same_data_is_refused_and_killing_the_first_ends_everything(
    launch: Launch,
) -> None:
    first = launch()
    lock = first.data / "stack.lock"
    assert eventually(lambda: lock.exists() and lock.read_text() != "", 20)
    second = launch()
    _, told = second.process.communicate(timeout=30)
    assert second.process.returncode == 1
    assert f"Process {first.process.pid} already runs a service" in told
    assert first.process.poll() is None

    first.url()
    assert len(first.family()) >= 7
    first.process.kill()
    assert eventually(lambda: first.family() == [], 10), first.family()


@pytest.mark.extra
def test_a_job_survives_a_restart_of_everything(launch: Launch) -> None:
    first = launch()
    url = first.url()
    answer = httpx.post(f"{url}/jobs", json=WAITS_FOR_A_GPU)
    assert answer.status_code == 202, answer.text
    first.process.send_signal(signal.SIGTERM)
    first.process.communicate(timeout=30)
    again = httpx.get(f"{launch().url()}/jobs/{answer.json()['id']}")
    assert again.json()["status"] == "queued"


@pytest.mark.extra
def test_tables_of_a_newer_version_end_the_start_with_what_to_do(launch: Launch, tmp_path: Path) -> None:
    with Postgres(tmp_path / DATA / "postgres") as server:
        schema.upgrade(connect_postgres(server.url, pool_size=0))
        with psycopg.connect(server.url) as connection:
            connection.execute("UPDATE alembic_version SET version_num = 'of a newer version'")
    stack = launch()
    _, told = stack.process.communicate(timeout=60)
    assert stack.process.returncode == 1
    assert "A newer version of Gaitway made the tables" in told
    assert stack.family() == []


def _of_the_api(stack: Launched) -> list[psutil.Process]:
    """The process of `api.main`, and those that it started to serve."""
    (parent,) = stack.named("api.main")
    return [
        parent,
        *(child for child in parent.children() if "resource_tracker" not in " ".join(child.cmdline())),
    ]


def _says_that_its_disk_was_full(stack: Launched) -> bool:
    with (stack.data / "objects/weed.log").open("a") as log:
        return log.write("write /data/filerldb2/04/000001.log: no space left on device\n") > 0


def _is_ready(url: str) -> bool:
    try:
        return httpx.get(f"{url}/readyz", timeout=1).status_code == 200
    except httpx.TransportError:
        return False
