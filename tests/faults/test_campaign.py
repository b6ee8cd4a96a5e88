"""A few seeds of the campaign (docs/reliability.md), in every run of all tests."""

import os
import random
import signal
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from tests.faults.bench import wait_until
from tests.faults.campaign.faults import CAMPAIGN
from tests.faults.campaign.outages import CAMPAIGN as OUTAGES
from tests.faults.campaign.proxy import Mode
from tests.faults.campaign.runner import Runner

SEEDS = (904, 5594, 6202)
SEED_OF_OUTAGES = 252


@pytest.fixture(scope="module")
def runner() -> Iterator[Runner]:
    with Runner() as runner:
        yield runner


def test_the_seeds_draw_every_kind_of_fault() -> None:
    names = {fault.name.split()[0] for seed in SEEDS for fault in CAMPAIGN.draw(random.Random(seed), 3.5)}
    modes = {mode.value for mode in Mode if mode not in (Mode.OPEN, Mode.LOSE_CLAIMS)}
    assert names == {*modes, "SIGKILL", "SIGSTOP", "SIGTERM", "FLUSHALL", "disk", "clock"}


@pytest.mark.extra
@pytest.mark.timeout(180)
@pytest.mark.parametrize("seed", SEEDS)
def test_no_promise_is_broken(runner: Runner, seed: int) -> None:
    outcome = runner.run(seed)
    assert not outcome.broken, (outcome.faults, outcome.broken)


def test_the_seed_of_outages_draws_what_must_cost_no_attempt() -> None:
    names = [fault.name for fault in OUTAGES.draw(random.Random(SEED_OF_OUTAGES), 3.5)]
    assert [name.split(" for ")[0] for name in names] == [
        "clock of worker-1 and worker-2 is off by -3 min",
        *["lose_claims between * and postgres"] * 2,
        "disk of postgres full",
        "Redis full",
    ]


@pytest.mark.extra
@pytest.mark.timeout(180)
def test_an_outage_costs_no_attempt_of_jobs_that_train_together() -> None:
    """H4, M1, M9: each job has one attempt, and the answers to all claims are lost at first."""
    with Runner("outages") as runner:
        outcome = runner.run(SEED_OF_OUTAGES)
    assert not outcome.broken, (outcome.faults, outcome.broken)


@pytest.mark.extra
def test_a_world_ends_with_its_process(runner: Runner) -> None:
    world = psutil.Process(runner.pid)
    # Three servers, and four that are the service.
    wait_until(lambda: len(world.children()) >= 7, timeout_s=60)
    below = world.children(recursive=True)
    os.kill(runner.pid, signal.SIGKILL)
    wait_until(lambda: not any(_lives(process) for process in below))


def _lives(process: psutil.Process) -> bool:
    # A container may have nobody who waits for orphans.
    return process.is_running() and Path(f"/proc/{process.pid}/exe").exists()
