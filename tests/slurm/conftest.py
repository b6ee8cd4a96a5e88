"""One Slurm and one service for all tests of this folder; they are skipped where there is no Slurm."""

from collections.abc import Iterator

import pytest

from tests.slurm.local_slurm import missing
from tests.slurm.world import World

OPTIONS = """
max = 4
idle = 8
grace = 10
start_margin = 15
tunnel = "none"
[cpu]
partition = "low"
cpus = 2
mem = "2G"
"""


@pytest.fixture(scope="session")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[World]:
    if (sentence := missing()) is not None:
        pytest.skip(sentence)
    with World(tmp_path_factory.mktemp("slurm")) as world:
        yield world


@pytest.fixture
def workers(world: World) -> World:
    """The world with workers on CPUs, and nodes that all work."""
    for node in ("n1", "n2"):
        world.slurm.command("scontrol", "update", f"nodename={node}", "state=resume", check=False)
    world.keep_workers(OPTIONS)
    return world
