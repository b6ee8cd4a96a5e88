"""Objects that the store has lost, or cannot give since a byte of its volume is another one, one by one.

Such an object is of a running or an ended job: its newest checkpoint, which the next attempt would begin
with, any other file, or a part of a feed. The worker that has the job may be killed right after, so that the
job has to be resumed. Parts of feeds are objects from a job's end on.

`python -m tests.faults.campaign.episode --kinds damage --seeds 100 [--first 0]`
"""

import random
import signal
from collections.abc import Callable, Sequence
from contextlib import suppress

from tests.faults.campaign.faults import Campaign, Fault
from tests.faults.campaign.volumes import flip_byte
from tests.faults.campaign.world import World

# A reader of a damaged object takes some ten seconds, and attempts that it ends are tried again.
_AFTERMATH_S = 40.0
_OF_FILES = "SELECT key FROM artifacts WHERE role {} ORDER BY job_id, step DESC NULLS FIRST"
_OF_FEEDS = "SELECT key FROM chunks ORDER BY job_id, channel"
_QUERIES = {
    "checkpoint": _OF_FILES.format("= 'checkpoint'"),
    "file": _OF_FILES.format("<> 'checkpoint'"),
    "part of a feed": _OF_FEEDS,
}
_NEWEST = (
    "SELECT DISTINCT ON (job_id) key FROM artifacts WHERE role = 'checkpoint' ORDER BY job_id, step DESC"
)


def _flip(world: World, key: str) -> None:
    if key in world.hurt:  # Reading it to flip it would take ten seconds.
        return
    with suppress(Exception):  # It has just gone.
        body = world.objects().get(key)
        world.hurt.add(key)
        flip_byte(world.weed_data, body)


def _lose(world: World, key: str) -> None:
    with suppress(Exception):
        world.hurt.add(key)
        world.objects().delete([key])


_WAYS: dict[str, Callable[[World, str], None]] = {"flipped": _flip, "lost": _lose}


def _keys(world: World, query: str) -> Sequence[str]:
    with suppress(Exception), world.database() as database:
        return [row[0] for row in database.execute(query)]  # type: ignore[call-overload]
    return ()


def _one_object(rng: random.Random, at_s: float, lasts_s: float) -> Fault:
    what, how = rng.choice(list(_QUERIES)), rng.choice(list(_WAYS))
    which = rng.random()

    def hurt(world: World) -> None:
        if keys := _keys(world, _QUERIES[what]):
            _WAYS[how](world, keys[int(which * len(keys))])

    return Fault(f"{how} {what}", at_s + lasts_s, 0.0, hurt, aftermath_s=_AFTERMATH_S)


def _newest_checkpoints(rng: random.Random, at_s: float, lasts_s: float) -> Fault:
    """Of every job; then a worker is killed, with its training or without."""
    how, worker = rng.choice(list(_WAYS)), rng.choice(("worker-1", "worker-2"))
    number = rng.choice((signal.SIGKILL, signal.SIGTERM))

    def hurt(world: World) -> None:
        for key in _keys(world, _NEWEST):
            _WAYS[how](world, key)
        world.signal(worker, number, which=0)

    name = f"{how} newest checkpoint of each job, {number.name} {worker}"
    return Fault(name, at_s, 0.0, hurt, aftermath_s=_AFTERMATH_S)


def _killed(rng: random.Random, at_s: float, lasts_s: float) -> Fault:
    party = rng.choice(("worker-1", "worker-2", "api", "reconciler", "weed"))
    return Fault(f"SIGKILL {party}", at_s, 0.0, lambda world: world.signal(party, signal.SIGKILL, which=0))


CAMPAIGN = Campaign(
    {"one_object": (_one_object, 6), "newest_checkpoints": (_newest_checkpoints, 4), "killed": (_killed, 2)}
)
