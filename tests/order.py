"""In which order files of tests are imported, and run: those that mostly wait beside those that compute."""

import gc
from collections import Counter
from collections.abc import Generator
from itertools import groupby
from pathlib import Path
from typing import Any

import pytest

from tests.durations import kept

# Their tests start processes, and wait for them and for one another.
_WAITING = ("tests/e2e/", "tests/faults/")
# The rest of a run is for files that are over soon: no process of it works alone at the end.
_UNTIL = 0.9


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node: Any) -> None:
    """All processes of a run order the tests alike."""
    node.workerinput["last_seconds"] = last_seconds()


@pytest.hookimpl(wrapper=True)
def pytest_collection(session: pytest.Session) -> Generator[None, Any, Any]:
    """Each process imports the files from another one on.

    All import all of them, and in a new clone whoever comes first compiles: in step, each would compile all.
    """
    config: Any = session.config  # With what xdist adds to it.
    if hasattr(config, "workerinput") and config.args == config.getini("testpaths"):
        files = sorted(str(file) for folder in config.args for file in Path(folder).rglob("test_*.py"))
        process, processes = int(config.workerinput["workerid"][2:]), config.workerinput["workercount"]
        first = process * len(files) // processes
        config.args = files[first:] + files[:first]
    gc.disable()  # What is imported stays: to look for garbage in it takes a second, here and whenever else.
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_collection_modifyitems(
    config: pytest.Config, items: list[pytest.Item]
) -> Generator[None, None, None]:
    items.sort(key=_file)  # However they were imported, all processes order them alike.
    yield
    items[:] = spread(items, getattr(config, "workerinput", {}).get("last_seconds", {}))  # Those that run.


def spread(items: list[pytest.Item], seconds: dict[str, float]) -> list[pytest.Item]:
    """The same tests, the files that wait spread evenly over the others.

    seconds: what files took. Those of each kind that took longest come first.
    """
    files = [list(tests) for _, tests in groupby(items, key=_file)]
    files.sort(key=lambda tests: -seconds.get(_file(tests[0]), 0.0))
    waiting = [tests for tests in files if _file(tests[0]).startswith(_WAITING)]
    computing = [tests for tests in files if not _file(tests[0]).startswith(_WAITING)]
    places = [
        *((number / len(waiting) * _UNTIL, tests) for number, tests in enumerate(waiting)),
        *((number / len(computing), tests) for number, tests in enumerate(computing)),
    ]
    return [test for _, tests in sorted(places, key=lambda place: place[0]) for test in tests]


def last_seconds() -> dict[str, float]:
    """The wall time of each file when it last ran; empty where it never did."""
    seconds = Counter[str]()
    for nodeid, (wall, _) in kept().items():
        seconds[nodeid.partition("::")[0]] += wall
    return dict(seconds)


def _file(item: pytest.Item) -> str:
    return item.nodeid.partition("::")[0]
