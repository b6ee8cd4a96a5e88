"""The embedded stack as a user starts it, and the processes it is made of."""

import signal
import subprocess
import sys
import time
from collections.abc import Generator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import httpx
import psutil

from gaitway.service.embedded.processes import free_ports

_START_S = 60.0
_STOP_S = 90.0


@dataclass(frozen=True)
class Stack:
    """A running service. pid: of its launcher."""

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
        return any(
            one.status == psutil.CONN_LISTEN and one.laddr.port == port
            for one in process.net_connections(kind="tcp")
        )
    return False


@contextmanager
def running_stack(data_dir: Path, *, workers: int = 1) -> Generator[Stack]:
    """The stack with its workers announced; ended with everything it started. Raises RuntimeError."""
    [port] = free_ports(1)
    data_dir.mkdir(parents=True, exist_ok=True)
    log = data_dir / "bench-stack.log"
    command = [sys.executable, "-m", "gaitway.service.embedded.up"]
    options = ["--port", str(port), "--data", str(data_dir), "--workers", str(workers)]
    with log.open("wb") as output:
        launcher = subprocess.Popen(
            [*command, *options], stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT
        )
    stack = Stack(f"http://127.0.0.1:{port}", port, launcher.pid)
    try:
        _wait_ready(stack, launcher, workers, log)
        yield stack
    finally:
        _end(launcher)


def _wait_ready(stack: Stack, launcher: subprocess.Popen[bytes], workers: int, log: Path) -> None:
    deadline = time.monotonic() + _START_S
    while time.monotonic() < deadline:
        if launcher.poll() is not None:
            break
        with suppress(httpx.HTTPError):
            if httpx.get(f"{stack.url}/readyz", timeout=2, trust_env=False).is_success:
                there = httpx.get(f"{stack.url}/workers?limit=200", timeout=2, trust_env=False)
                if len(there.json()["items"]) >= workers:
                    return
        time.sleep(0.1)
    last = log.read_text(errors="replace")[-2000:]
    raise RuntimeError(f"The stack was not ready within {_START_S:.0f} s; it said:\n{last}")


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
