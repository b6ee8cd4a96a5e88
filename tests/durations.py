"""How long each test takes: `.cache/durations.json` after every run, and a budget for each folder.

Seconds are of the wall, and of the processor: of the test's process and of those that it has waited for, so
that the second number hardly depends on what else the machine does. A whole run fails where a folder takes
more processor time than `BUDGETS` gives it: move what proves a promise twice to `./run test all`.

A budget is some 25 % more than what was measured with nothing compiled, on a machine whose host gave a tenth
of its time to others: there, the same work takes a third more processor time than on a quiet one.
"""

import json
import os
import time
from collections import defaultdict
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest

BUDGETS: dict[str, float] = {
    "e2e": 215,
    "unit/environments": 300,
    "unit/worker": 140,
    "learning": 175,
    "faults": 230,
    "api": 175,
    "api/pages": 220,
    "mujoco_compiled": 160,
    "unit/algorithms": 85,
    "contract": 135,
    "unit/rendering": 62,
    "unit/embedded": 60,
    "unit/gaitway": 80,
    "unit/jobs": 40,
    "unit/physics": 40,
    "architecture": 30,
    "unit": 30,
    "unit/adapters": 20,
    "unit/sweeps": 20,
    "unit/bench": 10,
    "unit/clips": 20,
    "unit/storage": 10,
}
KEPT = Path(__file__).parents[1] / ".cache" / "durations.json"
_seconds = dict[str, tuple[float, float]]()


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> Generator[None, Any, Any]:
    item.stash[_BEGAN] = _now()
    item.stash[_IS_LAST] = nextitem is None
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    # With the last test of a process its servers end: what they took is not that test's.
    if call.when != "teardown" or not item.stash[_IS_LAST]:
        item.stash[_ENDED] = _now()
    if call.when == "teardown":
        wall, processor = (
            end - began for end, began in zip(item.stash[_ENDED], item.stash[_BEGAN], strict=True)
        )
        item.user_properties.append(("seconds", [round(wall, 3), round(processor, 3)]))
    return (yield)


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    if report.when == "teardown":
        for name, value in report.user_properties:
            if name == "seconds":
                _seconds[report.nodeid] = tuple(value)


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    if hasattr(session.config, "workerinput") or not _seconds:
        return
    KEPT.parent.mkdir(exist_ok=True)
    all_of_them = {**kept(), **_seconds}
    KEPT.write_text(json.dumps(dict(sorted(all_of_them.items(), key=lambda one: -one[1][1])), indent=0))
    if BUDGETS and _is_whole(session.config) and over_budget() and session.exitstatus == 0:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    folders = by_folder()
    if len(_seconds) < 50:
        return
    terminalreporter.section("seconds by folder: wall, processor, budget")
    for folder, (wall, processor) in sorted(folders.items(), key=lambda one: -one[1][1]):
        budget = f"{BUDGETS[folder]:7.0f}" if folder in BUDGETS else ""
        terminalreporter.line(f"{folder:32} {wall:7.0f} {processor:7.0f} {budget}")
    if _is_whole(terminalreporter.config):
        for folder in over_budget():
            terminalreporter.line(f"{folder} takes more than its budget: see {KEPT.name}", red=True)


def kept() -> dict[str, tuple[float, float]]:
    """Seconds of each test when it last ran here: wall, processor."""
    return json.loads(KEPT.read_text()) if KEPT.exists() else {}


def by_folder() -> dict[str, tuple[float, float]]:
    """Seconds of the tests below each folder of `BUDGETS`' depth: wall, processor."""
    totals: dict[str, list[float]] = defaultdict(lambda: [0.0, 0.0])
    for nodeid, seconds in _seconds.items():
        parts = nodeid.split("::")[0].removeprefix("tests/").split("/")[:-1]
        folder = "/".join(parts[:2] if parts[:1] in (["unit"], ["api"]) else parts[:1])
        for place, value in enumerate(seconds):
            totals[folder][place] += value
    return {folder: (wall, processor) for folder, (wall, processor) in totals.items()}


def over_budget() -> list[str]:
    """The folders that take more processor time than they have."""
    return [folder for folder, (_, spent) in by_folder().items() if spent > BUDGETS.get(folder, float("inf"))]


def _is_whole(config: pytest.Config) -> bool:
    """Whether this was the default suite: all of it, no more, and nothing that counts its lines."""
    whole = config.args == config.getini("testpaths") and not config.option.keyword
    return whole and "not extra" in config.option.markexpr and not config.option.cov_source


def _now() -> tuple[float, float]:
    times = os.times()
    return time.monotonic(), times.user + times.system + times.children_user + times.children_system


_BEGAN, _ENDED = pytest.StashKey[tuple[float, float]](), pytest.StashKey[tuple[float, float]]()
_IS_LAST = pytest.StashKey[bool]()
