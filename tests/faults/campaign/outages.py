"""Outages that must cost no attempt: each job has one.

full Redis (maxmemory is reached), full disks of the stores, clocks of workers that are minutes off, answers
that are lost: those of claims, and any between a worker and a store.
"""

import random
from collections.abc import Mapping

from tests.faults.campaign.faults import Campaign, Fault, Kinds, full_disk, misbehaving
from tests.faults.campaign.proxy import Mode
from tests.faults.campaign.world import STORES, World

_WORKERS = ("worker-1", "worker-2")
# Not a worker's disk: a job for which that has no room goes to another worker, and counts.
_DISKS = ("postgres", "weed")
_MINUTES = (3, 7, 11, 20)
# A clock is off for longer than a job takes.
_ALL_ALONG_S = 8.0


def _redis_full(rng: random.Random, at_s: float, lasts_s: float) -> Fault:
    def limit(world: World, max_bytes: str) -> None:
        with world.redis() as client:
            client.config_set("maxmemory", max_bytes)

    # Afterwards it has what the embedded one has, also where two such faults overlap.
    return Fault(
        f"Redis full for {lasts_s:g} s",
        at_s,
        lasts_s,
        lambda world: limit(world, "1"),
        lambda world: limit(world, "128mb"),
    )


def _disk_full(rng: random.Random, at_s: float, lasts_s: float) -> Fault:
    return full_disk(rng.choice(_DISKS), at_s, lasts_s)


def _clock_off(rng: random.Random, at_s: float, lasts_s: float) -> Fault:
    """The clocks of one worker or of both, from the beginning."""
    whose = rng.choice((*((one,) for one in _WORKERS), _WORKERS))
    minutes = rng.choice((1, -1)) * rng.choice(_MINUTES)

    def step(world: World, to_s: float) -> None:
        if world.clocks:
            for name in whose:
                world.clocks.set(name, to_s)

    return Fault(
        f"clock of {' and '.join(whose)} is off by {minutes} min",
        0.0,
        _ALL_ALONG_S,
        lambda world: step(world, 60.0 * minutes),
        lambda world: step(world, 0.0),
    )


def _claims_lost(rng: random.Random, at_s: float, lasts_s: float) -> Fault:
    """From the beginning: that is when jobs are claimed."""
    party = rng.choice((*_WORKERS, "*"))
    return misbehaving(party, "postgres", Mode.LOSE_CLAIMS, rng.choice((0.0, at_s)), 2 * lasts_s)


def _cut_off(rng: random.Random, at_s: float, lasts_s: float) -> Fault:
    """Shorter than a lease; nothing that takes longer than that to be noticed."""
    mode = rng.choice((Mode.REFUSE, Mode.SILENT, Mode.LOSE_ANSWERS, Mode.TRUNCATE))
    return misbehaving(rng.choice((*_WORKERS, "*")), rng.choice(STORES), mode, at_s, min(lasts_s, 2.5))


_KINDS: Kinds = {
    "redis_full": (_redis_full, 4),
    "disk_full": (_disk_full, 3),
    "clock_off": (_clock_off, 3),
    "claims_lost": (_claims_lost, 4),
    "cut_off": (_cut_off, 3),
}
_SETTINGS: Mapping[str, str] = {"GAITWAY_LEASE": "12"}
CAMPAIGN = Campaign(_KINDS, spec={"max_attempts": 1}, settings=_SETTINGS)
