"""Whose turn it is: a month of jobs under the policy and under first come, first served; 64 workers that ask.

`month --picture docs/pictures/turns.png` draws it, too, from a fixed seed; `claims` measures PostgreSQL.
"""

import argparse
from importlib import import_module
from pathlib import Path

from bench.summary import Figure

PARTS = ("month", "claims")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"of {', '.join(PARTS)}; all by default")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="month: where its picture goes")


def measure(arguments: argparse.Namespace) -> list[Figure]:
    """The parts that were named, or all."""
    if unknown := set(arguments.parts) - set(PARTS):
        raise SystemExit(f"There is no part {unknown.pop()!r} of the bench `turns`.")
    parts = arguments.parts or PARTS
    return [figure for part in parts for figure in import_module(f"{__name__}.{part}").measure(arguments)]
