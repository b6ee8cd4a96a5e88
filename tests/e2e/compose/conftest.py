"""Needs a Docker engine with Compose v2: `./run test compose` ends with an error where there is none."""

import shutil
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.e2e.compose.project import Project, removing, run, surroundings

ROOT = Path(__file__).parents[3]
_HAVE_ENGINE = ("docker", "compose", "version"), ("docker", "info")


@dataclass(frozen=True)
class Figure:
    """Something measured on the way. target: the most it should be."""

    name: str
    value: float
    unit: str
    target: float | None = None


FIGURES: list[Figure] = []


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    for item in items:
        if item.nodeid.startswith("tests/e2e/compose/"):
            item.add_marker(pytest.mark.compose)
    if "compose" in str(config.option.markexpr).split("not compose")[0] and not _engine():
        pytest.exit(
            "There is no Docker engine with Compose v2 here (`docker info`, `docker compose version`): "
            "nothing of the images was tested.",
            returncode=3,
        )


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    if not FIGURES:
        return
    terminalreporter.section("figures")
    for figure in FIGURES:
        target = "" if figure.target is None else f"  (at most {figure.target:g})"
        terminalreporter.line(f"{figure.name:<58} {figure.value:>9.1f} {figure.unit}{target}")


@pytest.fixture
def report() -> list[Figure]:
    """Where a test leaves what it measured; the summary shows it."""
    return FIGURES


@pytest.fixture(scope="session")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tree as a clone would have it: what git knows or would add, and nothing built."""
    folder = tmp_path_factory.mktemp("clone") / "gaitway"
    listed = run("git", "-C", str(ROOT), "ls-files", "-z", "--cached", "--others", "--exclude-standard")
    for name in filter(None, listed.split("\0")):
        if (ROOT / name).exists():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
    return folder


@pytest.fixture(scope="session")
def images(checkout: Path) -> str:
    """The images' tag, built."""
    project = Project(checkout, {"GAITWAY_TAG": "test"})
    started = time.monotonic()
    project.compose("build")
    FIGURES.append(Figure("build of api and worker", time.monotonic() - started, "s"))
    return "test"


@pytest.fixture(scope="session")
def project(checkout: Path, images: str) -> Iterator[Project]:
    """A running service, with no job yet."""
    with removing(Project(checkout, {"GAITWAY_TAG": images})) as found:
        started = time.monotonic()
        found.compose("up", "--detach")
        spec = {"kind": "rollout", "environment": "ant", "policy": {"kind": "zero"}, "num_steps": 1}
        found.wait_until_it_accepts(spec, 60)
        FIGURES.append(Figure("up on built images to a job accepted", time.monotonic() - started, "s", 15))
        yield found


def _engine() -> bool:
    try:
        return all(
            subprocess.run(command, capture_output=True, check=False, env=surroundings()).returncode == 0
            for command in _HAVE_ENGINE
        )
    except FileNotFoundError:
        return False
