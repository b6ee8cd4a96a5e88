"""The service as separate child processes, each known by its name."""

import os
import sys
import time
from collections.abc import Generator, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import httpx
import psutil

from gaitway.service.embedded.folders import private_folder
from gaitway.service.embedded.processes import ServerProcess, free_ports
from gaitway.service.embedded.servers import EmbeddedServers

_START_S = 60.0


@dataclass(frozen=True)
class Parts:
    """A running service. environment: the settings that lead to its stores. processes: all, by name."""

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


@contextmanager
def running(folder: Path, *, workers: int = 0, worker: str = "worker.main") -> Generator[Parts]:
    """The embedded stack's servers, its API, its reconciler, and CPU workers of this module."""
    private_folder(folder)
    with ExitStack() as stack:
        servers = stack.enter_context(EmbeddedServers(folder))
        [port] = free_ports(1)
        url = f"http://127.0.0.1:{port}"
        environment = {
            **os.environ,
            **servers.environment(),
            "GAITWAY_DATA_DIR": str(folder),
            "GAITWAY_DEVICE": "cpu",
            "PYTHONPATH": str(Path(__file__).parents[2]),
            "PYTHONUNBUFFERED": "1",
        }
        processes = {server.process.name: server.process for server in servers.all}
        modules = {"reconciler": ["worker.reconciler"], "api": ["api", "--port", str(port)]}
        modules |= {f"worker-{number}": [worker] for number in range(1, workers + 1)}
        for name, module in modules.items():
            process = processes[name] = ServerProcess(name, private_folder(folder / name))
            process.start([sys.executable, "-m", *module], environment)
            stack.callback(process.stop, 40 if name.startswith("worker") else 3)
        _wait_ready(url, workers, processes)
        yield Parts(url, environment, processes)


def _wait_ready(url: str, workers: int, processes: dict[str, ServerProcess]) -> None:
    deadline = time.monotonic() + _START_S
    while time.monotonic() < deadline:
        for process in processes.values():
            process.check()
        with suppress(httpx.HTTPError):
            if httpx.get(f"{url}/readyz", timeout=2, trust_env=False).is_success:
                there = httpx.get(f"{url}/workers?limit=200", timeout=2, trust_env=False).json()["items"]
                if len(there) >= workers:
                    return
        time.sleep(0.1)
    raise RuntimeError(f"The service was not ready within {_START_S:.0f} s.")
