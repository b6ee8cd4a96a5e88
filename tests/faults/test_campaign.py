"""A few seeds of the campaign (docs/reliability.md), in every run of the tests."""

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from tests.faults.bench import wait_until
from tests.faults.campaign.runner import Runner

# Between them they draw every kind of fault.
SEEDS = (9, 10, 12, 13, 16, 24, 27)


@pytest.fixture(scope="module")
def runner() -> Iterator[Runner]:
    with Runner() as runner:
        yield runner


@pytest.mark.timeout(180)
@pytest.mark.parametrize("seed", SEEDS)
def test_no_promise_is_broken(runner: Runner, seed: int) -> None:
    outcome = runner.run(seed)
    assert not outcome.broken, (outcome.faults, outcome.broken)


def test_a_world_ends_with_its_process(runner: Runner) -> None:
    below = psutil.Process(runner.pid).children(recursive=True)
    assert len(below) >= 7  # Three servers, and four that are the service.
    os.kill(runner.pid, signal.SIGKILL)
    wait_until(lambda: not any(_lives(process) for process in below))


def _lives(process: psutil.Process) -> bool:
    # A container may have nobody who waits for orphans.
    return process.is_running() and Path(f"/proc/{process.pid}/exe").exists()
