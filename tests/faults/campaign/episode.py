"""One episode: users at work, faults at their times, everything healed, and what the checker finds.

`python -m tests.faults.campaign.episode --seeds 100 [--first 0]` runs many in one world, and prints a line of
JSON for each. `--kinds outages` draws other faults. `--serve FOLDER` takes the seeds from its standard input.
"""

import argparse
import os
import random
import sys
import threading
import time
from collections.abc import Iterable, Sequence
from pathlib import Path

import structlog

from tests.faults.campaign.checker import check
from tests.faults.campaign.clients import Users
from tests.faults.campaign.disks import take_own_mounts
from tests.faults.campaign.faults import Campaign, Fault, campaign_of
from tests.faults.campaign.runner import READY, Outcome
from tests.faults.campaign.world import PARTIES, SERVERS, World
from worker.host.processes import PARENT, die_with_parent

NUM_JOBS = 4
_FAULTS_WITHIN_S = 3.5
_END_WITHIN_S = 60.0


def run(world: World, seed: int, campaign: Campaign) -> Outcome:
    """The result of the episode that this seed draws."""
    rng = random.Random(seed)
    faults = campaign.draw(rng, _FAULTS_WITHIN_S)
    started = time.monotonic()
    users = Users(world.url, NUM_JOBS, rng, campaign.spec)
    _happen(world, faults, started)
    world.heal()
    late = users.wait(_END_WITHIN_S + max(fault.aftermath_s for fault in faults))
    broken = [f"a user was never told the end: {name}" for name in late]
    try:
        world.wait_ready()
    except TimeoutError as error:
        broken.append(str(error))
    broken += check(world, users)
    seconds = round(time.monotonic() - started, 1)
    return Outcome(seed, tuple(fault.name for fault in faults), tuple(broken), seconds)


def _happen(world: World, faults: Sequence[Fault], started: float) -> None:
    """Do and undo the faults at their times."""
    todo = [(fault.at_s, fault.do) for fault in faults]
    todo += [(fault.at_s + fault.lasts_s, fault.undo) for fault in faults]
    for at_s, action in sorted(todo, key=lambda one: one[0]):
        threading.Event().wait(max(0.0, started + at_s - time.monotonic()))
        action(world)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--kinds", default="faults", help="the module of this folder that draws the faults")
    parser.add_argument("--serve", type=Path, metavar="FOLDER", help="a world there, for seeds that are sent")
    parser.add_argument("--keep", action="store_true", help="stop at the first broken promise")
    given = parser.parse_args(arguments)
    # The standard output is for outcomes; what looks into the store may have warnings.
    structlog.configure(logger_factory=structlog.PrintLoggerFactory(sys.stderr))
    if PARENT in os.environ:
        die_with_parent()
    if not (has_own_mounts := take_own_mounts()):
        print("No disk gets full: this user may not mount any.", file=sys.stderr)
    seeds: Iterable[int] = range(given.first, given.first + given.seeds)
    places = {}
    if given.serve is not None:
        seeds, places = map(int, sys.stdin), {"folder": given.serve}
    is_broken, campaign = False, campaign_of(given.kinds)
    with World(**places, has_own_mounts=has_own_mounts, settings=campaign.settings) as world:
        if not world.clocks:
            print("No C compiler: instead of clocks, the times that are stored move.", file=sys.stderr)
        if given.serve is not None:
            print(READY, end="", flush=True)
        for seed in seeds:
            outcome = run(world, seed, campaign)
            is_broken |= bool(outcome.broken)
            print(outcome.line(), flush=True)
            if outcome.broken:
                crashes = [line for line in world.logs("api").splitlines() if "request_crashed" in line]
                print(*crashes, sep="\n", file=sys.stderr)
                for party in (*PARTIES, *SERVERS):
                    print(f"--- seed {seed}, {party}\n{world.logs(party)[-6000:]}", file=sys.stderr)
                if given.keep:
                    break
    return 1 if is_broken else 0


if __name__ == "__main__":
    sys.exit(main())
