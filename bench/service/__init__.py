"""The service: submissions, what accounts add, lists among a million jobs, the table of ten thousand, claims
by 64 workers, what teams do, load with feeds, the page, the largest requests; `sharing` where a GPU is.

The embedded stack's servers, the requests and the measuring share the machine.
"""

import argparse
from importlib import import_module

from bench.summary import Figure

PARTS = ("submissions", "accounts", "lists", "sorting", "claims", "teams", "load", "page", "largest")
ON_GPUS = ("sharing",)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "parts", nargs="*", metavar="PART", help=f"of {', '.join(PARTS)}; these by default; or sharing"
    )
    parser.add_argument("--minutes", type=float, default=5.0, metavar="M", help="load: how long it lasts")
    parser.add_argument("--only", default="*", metavar="PATTERN", help="largest: such routes, `GET *` say")


def measure(arguments: argparse.Namespace) -> list[Figure]:
    """The parts that were named, or all."""
    if unknown := set(arguments.parts) - {*PARTS, *ON_GPUS}:
        raise SystemExit(f"There is no part {unknown.pop()!r} of the bench `service`.")
    parts = arguments.parts or PARTS
    return [figure for part in parts for figure in import_module(f"{__name__}.{part}").measure(arguments)]
