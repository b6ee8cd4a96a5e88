"""A service with real parts, for the tests of a module to share."""

import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from gaitway.client import Client
from gaitway.service.embedded.processes import free_ports
from tests.compiling import compiling_quickly
from tests.e2e.installed import Installed, install
from tests.kept_programs import KEPT
from worker.compile_cache.local import CACHE, lend, take_over


@contextmanager
def serving(data: Path, workers: int = 1, python: str = sys.executable) -> Iterator[Client]:
    """A client of a stack with so many workers. data: its folder. python: its interpreter.

    The worker finds what earlier stacks compiled.
    """
    lend(KEPT / "service", programs := data / CACHE / KEPT.name)
    port = free_ports(1)[0]
    options = ["--data", str(data), "--port", str(port), "--workers", str(workers)]
    command = [python, "-m", "gaitway.service.embedded.up", *options]
    stack = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True)
    with stack, Client(f"http://127.0.0.1:{port}") as client:
        assert stack.stdout is not None
        assert stack.stdout.readline()
        yield client
        stack.send_signal(signal.SIGTERM)
        stack.communicate(timeout=60)
    take_over(programs, KEPT / "service")


@pytest.fixture(scope="module")
def stack_folder(tmp_path_factory: pytest.TempPathFactory, postgres_data: Path) -> Path:
    """The data folder of the stack behind `client`."""
    data = tmp_path_factory.mktemp("stack")
    shutil.copytree(postgres_data, data / "postgres" / "data")
    return data


@pytest.fixture(scope="module")
def client(stack_folder: Path) -> Iterator[Client]:
    """A client of a stack with one worker."""
    with serving(stack_folder) as client:
        yield client


@pytest.fixture(scope="module")
def quick_client(tmp_path_factory: pytest.TempPathFactory, postgres_data: Path) -> Iterator[Client]:
    """A client of such a stack whose trainings run for moments, and are compiled quickly."""
    data = tmp_path_factory.mktemp("quick_stack")
    shutil.copytree(postgres_data, data / "postgres" / "data")
    with pytest.MonkeyPatch.context() as environment:
        for name, value in compiling_quickly().items():
            environment.setenv(name, value)
        with serving(data) as client:
            yield client


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Installed:
    """The wheel with its extras `cli` and `policy`, where a user has installed it."""
    return install(tmp_path_factory.mktemp("installed"), "cli", "policy")
