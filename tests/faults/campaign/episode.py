"""One episode: users at work, faults at their times, everything healed, and what the checker finds.

`python -m tests.faults.campaign.episode --seeds 100 [--first 0]` runs many in one world, and prints each.
"""

import argparse
import json
import random
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass

from tests.faults.campaign.checker import check
from tests.faults.campaign.clients import Users
from tests.faults.campaign.faults import Fault, draw
from tests.faults.campaign.world import World

NUM_JOBS = 4
_FAULTS_WITHIN_S = 3.5
_END_WITHIN_S = 60.0


@dataclass(frozen=True)
class Outcome:
    """seed: it draws jobs and faults. broken: sentences of the checker."""

    seed: int
    faults: Sequence[str]
    broken: Sequence[str]
    seconds: float
    statuses: Sequence[str]


def run(world: World, seed: int) -> Outcome:
    """What became of the episode that this seed draws."""
    rng = random.Random(seed)
    faults = draw(rng, _FAULTS_WITHIN_S)
    started = time.monotonic()
    users = Users(world.url, NUM_JOBS, rng)
    _happen(world, faults, started)
    world.heal()
    late = users.wait(_END_WITHIN_S)
    broken = [f"a user was never told the end: {name}" for name in late]
    try:
        world.wait_ready()
    except TimeoutError as error:
        broken.append(str(error))
    broken += check(world, users)
    statuses = [told.statuses[-1] if told.statuses else "-" for told in users.told]
    return Outcome(seed, [fault.name for fault in faults], broken, time.monotonic() - started, statuses)


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
    parser.add_argument("--keep", action="store_true", help="stop at the first broken promise, with its logs")
    given = parser.parse_args(arguments)
    num_broken = 0
    with World() as world:
        for seed in range(given.first, given.first + given.seeds):
            outcome = run(world, seed)
            num_broken += bool(outcome.broken)
            print(json.dumps(outcome.__dict__), flush=True)
            if outcome.broken and given.keep:
                for party in ("api", "reconciler", "worker-1", "worker-2"):
                    print(f"--- {party}\n{world.logs(party)[-6000:]}", file=sys.stderr)
                break
    print(json.dumps({"episodes": given.seeds, "broken": num_broken}))
    return 1 if num_broken else 0


if __name__ == "__main__":
    sys.exit(main())
