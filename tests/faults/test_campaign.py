"""A few seeds of the campaign (docs/reliability.md), in every run of the tests."""

from collections.abc import Iterator

import pytest

from tests.faults.campaign.episode import run
from tests.faults.campaign.world import World

# Between them they draw every kind of fault.
SEEDS = (9, 10, 12, 13, 16, 24, 27)


@pytest.fixture(scope="module")
def world() -> Iterator[World]:
    with World() as world:
        yield world


@pytest.mark.timeout(180)
@pytest.mark.parametrize("seed", SEEDS)
def test_no_promise_is_broken(world: World, seed: int) -> None:
    outcome = run(world, seed)
    assert not outcome.broken, (outcome.faults, outcome.broken)
