"""Services that benches measure, as a user starts them or as separate processes; and a Chromium."""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import httpx
import psutil

from core.settings import WorkerSettings
from gaitway.service.embedded.folders import private_folder
from gaitway.service.embedded.processes import ServerProcess, free_ports
from gaitway.service.embedded.servers import EmbeddedServers

if TYPE_CHECKING:
    from playwright.sync_api import Browser

_START_S, _STOP_S = 60.0, 90.0
_CHROMIUM = ("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync")
_PREFIX = "GAITWAY_"


@dataclass(frozen=True)
class Stack:
    """A service that `gaitway up` has started. pid: of its launcher."""

    url: str
    port: int
    pid: int

    def api_processes(self) -> list[psutil.Process]:
        """The processes that listen on the service's port. Raises RuntimeError if there is none."""
        launcher = psutil.Process(self.pid)
        family = (launcher, *launcher.children(recursive=True))
        if found := [process for process in family if _listens(process, self.port)]:
            return found
        raise RuntimeError(f"No process of the stack listens at port {self.port}.")

    def cpu_s(self) -> dict[str, float]:
        """Processor seconds used so far by `api`, and by the stack's other programs under their names."""
        api = {process.pid for process in self.api_processes()}
        used: dict[str, float] = {}
        for process in psutil.Process(self.pid).children(recursive=True):
            with suppress(psutil.Error):
                name = "api" if process.pid in api else process.name()
                times = process.cpu_times()
                used[name] = used.get(name, 0.0) + times.user + times.system
        return used


def _listens(process: psutil.Process, port: int) -> bool:
    with suppress(psutil.Error):
        found = process.net_connections(kind="tcp")
        return any(one.status == psutil.CONN_LISTEN and one.laddr.port == port for one in found)
    return False


def up_command(data_dir: Path, *options: str) -> list[str]:
    return [sys.executable, "-m", "gaitway.service.embedded.up", "--data", str(data_dir), *options]


@contextmanager
def running_stack(data_dir: Path, *, workers: int = 1) -> Generator[Stack]:
    """The stack with its workers announced; ended with everything it started. Raises RuntimeError."""
    [port] = free_ports(1)
    data_dir.mkdir(parents=True, exist_ok=True)
    log = data_dir / "bench-stack.log"
    command = up_command(data_dir, "--port", str(port), "--workers", str(workers))
    with log.open("wb") as output:
        launcher = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT
        )
    stack = Stack(f"http://127.0.0.1:{port}", port, launcher.pid)
    try:
        _wait_ready(stack.url, workers, lambda: launcher.poll() is None)
        yield stack
    except TimeoutError as late:
        raise RuntimeError(f"{late} It said:\n{log.read_text(errors='replace')[-2000:]}") from late
    finally:
        _end(launcher)


def _end(launcher: subprocess.Popen[bytes]) -> None:
    started: list[psutil.Process] = []
    with suppress(psutil.NoSuchProcess):
        started = psutil.Process(launcher.pid).children(recursive=True)
    if launcher.poll() is None:
        launcher.send_signal(signal.SIGINT)
    try:
        launcher.wait(_STOP_S)
    except subprocess.TimeoutExpired:
        launcher.kill()
        launcher.wait()
    # Only processes that this stack started and that are still alive; psutil recognises a reused id.
    for process in started:
        with suppress(psutil.NoSuchProcess):
            process.kill()


@dataclass(frozen=True)
class Parts:
    """A service as separate processes. environment: the settings that lead to its stores."""

    url: str
    environment: dict[str, str]
    processes: dict[str, ServerProcess]

    def family(self, name: str) -> Iterator[psutil.Process]:
        """A part and all processes it has started. Raises RuntimeError if it has ended."""
        pid = self.processes[name].pid
        if pid is None:
            raise RuntimeError(f"{name} has ended.\n{self.processes[name].last_lines()}")
        leader = psutil.Process(pid)
        yield leader
        with suppress(psutil.NoSuchProcess):
            yield from leader.children(recursive=True)

    def cpu_s(self, name: str) -> float:
        """Processor seconds of a part until now, with those of all that it has started."""
        used = 0.0
        for process in self.family(name):
            with suppress(psutil.NoSuchProcess):
                times = process.cpu_times()
                used += times.user + times.system + times.children_user + times.children_system
        return used

    def settings(self, **more: str) -> WorkerSettings:
        """The settings that a worker of this service would have."""
        values = {
            name.removeprefix(_PREFIX).lower(): value
            for name, value in self.environment.items()
            if name.startswith(_PREFIX)
        }
        known = {name: values[name] for name in WorkerSettings.model_fields if name in values}
        return WorkerSettings.model_validate({**known, **more})


@contextmanager
def running_parts(*, workers: int = 0, worker: str = "worker.main") -> Generator[Parts]:
    """The embedded stack's servers, its API, its reconciler, and CPU workers of this module."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="gaitway-bench-")), "stack")
        private_folder(folder)
        servers = stack.enter_context(EmbeddedServers(folder))
        [port] = free_ports(1)
        url = f"http://127.0.0.1:{port}"
        environment = {
            **os.environ,
            **servers.environment(),
            "GAITWAY_DATA_DIR": str(folder),
            "GAITWAY_DEVICE": "cpu",
            "PYTHONPATH": str(Path(__file__).parents[1]),
            "PYTHONUNBUFFERED": "1",
        }
        processes = {server.process.name: server.process for server in servers.all}
        modules = {"reconciler": ["worker.reconciler"], "api": ["api", "--port", str(port)]}
        modules |= {f"worker-{number}": [worker] for number in range(1, workers + 1)}
        for name, module in modules.items():
            process = processes[name] = ServerProcess(name, private_folder(folder / name))
            process.start([sys.executable, "-m", *module], environment)
            stack.callback(process.stop, 40 if name.startswith("worker") else 3)
        _wait_ready(url, workers, lambda: all(process.check() is None for process in processes.values()))
        yield Parts(url, environment, processes)


def _wait_ready(url: str, workers: int, lives: Callable[[], bool]) -> None:
    """Raises TimeoutError where it does not come, or has ended."""
    deadline = time.monotonic() + _START_S
    while time.monotonic() < deadline and lives():
        with suppress(httpx.HTTPError):
            if httpx.get(f"{url}/readyz", timeout=2, trust_env=False).is_success:
                there = httpx.get(f"{url}/workers?limit=200", timeout=2, trust_env=False).json()["items"]
                if len(there) >= workers:
                    return
        time.sleep(0.1)
    raise TimeoutError(f"The service was not ready within {_START_S:.0f} s.")


@contextmanager
def chromium(*flags: str) -> Generator["Browser"]:
    """A Chromium without a window. Raises RuntimeError where there is none."""
    path = shutil.which("chromium") or shutil.which("google-chrome")
    if path is None:
        raise RuntimeError("There is no Chromium; on Debian: apt-get install chromium fonts-dejavu-core")
    from playwright.sync_api import sync_playwright  # A GPU machine that measures training has no browser.

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=[*_CHROMIUM, *flags])
        yield browser
        browser.close()


def until(holds: Callable[[], bool], timeout_s: float = 300.0) -> None:
    """Return once the condition holds, checked ten times a second. Raises TimeoutError."""
    deadline = time.monotonic() + timeout_s
    while not holds():
        if time.monotonic() > deadline:
            raise TimeoutError(f"The condition did not hold within {timeout_s:.0f} s.")
        time.sleep(0.1)
