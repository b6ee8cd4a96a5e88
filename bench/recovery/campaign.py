"""The campaign of tests/faults/campaign, which tries to break the promises of docs/reliability.md.

Each seed draws jobs, some of them cancelled, and faults. Then all is healed, and the checker compares what
users were told, and what is stored, with an undisturbed run. A line is printed for each episode.
"""

import argparse
import os
from collections import Counter
from collections.abc import Iterator

from bench.summary import Figure, percentile
from tests.faults.campaign.episode import NUM_JOBS
from tests.faults.campaign.runner import Outcome, run_all


def measure(arguments: argparse.Namespace) -> Iterator[Figure]:
    """Run worlds side by side, one for every two cores unless the arguments name a number."""
    num_seeds = min(4, arguments.seeds) if arguments.quick else arguments.seeds
    seeds = range(arguments.first, arguments.first + num_seeds)
    kinds = arguments.kinds or ["faults"]
    worlds = arguments.worlds or max(1, (os.cpu_count() or 2) // 2)
    outcomes: list[Outcome] = []
    for kind, outcome in run_all(((kind, seed) for kind in kinds for seed in seeds), worlds):
        outcomes.append(outcome)
        print(kind, outcome.line(), flush=True)
    faults = Counter(_kind(fault) for outcome in outcomes for fault in outcome.faults)
    broken = [outcome.seed for outcome in outcomes if outcome.broken]
    named = f" (seeds {', '.join(map(str, broken[:10]))})" if broken else ""
    yield Figure(f"campaign: episodes with a broken promise{named}", len(broken), at_most=0)
    yield Figure(f"campaign: episodes of {', '.join(kinds)}, {worlds} worlds side by side", len(outcomes))
    yield Figure("campaign: jobs", NUM_JOBS * len(outcomes))
    most = ", ".join(f"{kind} {count}" for kind, count in faults.most_common(6))
    yield Figure(f"campaign: faults (most: {most})", faults.total())
    seconds = [outcome.seconds for outcome in outcomes]
    yield Figure("campaign: an episode, median", percentile(seconds, 50), "s")


def _kind(fault: str) -> str:
    """The kind of fault, without the process it hit and its duration."""
    return " ".join(fault.split()[:2]) if fault.startswith("SIG") else fault.split()[0]
