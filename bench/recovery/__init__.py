"""The cost of recovery: killed workers, damaged checkpoints, outages; a campaign of faults; hours of jobs.

`--kinds` runs the campaign alone: `--kinds faults outages --worlds 2 --first 0 --seeds 1000`.
"""

import argparse
from importlib import import_module

from bench.summary import Figure

PARTS = ("kills", "outages", "campaign", "soak")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"of {', '.join(PARTS)}; by default kills")
    parser.add_argument("--minutes", type=float, metavar="M", help="outages (10), soak (60): how long")
    campaign = parser.add_argument_group("the campaign")
    campaign.add_argument("--kinds", nargs="+", metavar="KIND", help="modules of tests/faults/campaign")
    campaign.add_argument("--worlds", type=int, metavar="N", help="deployments side by side")
    campaign.add_argument("--first", type=int, default=0, metavar="SEED", help="the first of its seeds")
    campaign.add_argument("--seeds", type=int, default=1000, metavar="N", help="how many of each kind")


def measure(arguments: argparse.Namespace) -> list[Figure]:
    """The parts that were named."""
    if unknown := set(arguments.parts) - set(PARTS):
        raise SystemExit(f"There is no part {unknown.pop()!r} of the bench `recovery`.")
    parts = arguments.parts or (["campaign"] if arguments.kinds else ["kills"])
    return [figure for part in parts for figure in import_module(f"{__name__}.{part}").measure(arguments)]
