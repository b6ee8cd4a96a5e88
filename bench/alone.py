"""A bench under its own name, `python -m bench.NAME`, where only the packages of a training are installed."""

import argparse
import sys
import tempfile
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path

from rich.console import Console

from bench.machine import this_commit, this_machine
from bench.summary import Figure, Run, save, show


def run_alone(
    name: str,
    parser: argparse.ArgumentParser,
    measure: Callable[[argparse.Namespace, Path], Iterator[Figure]],
) -> None:
    """Measure as the command line says, print the figures as a table, and keep them.

    parser: with the arguments that this bench alone has. measure: from the arguments, and a folder for what
    the trainings compile.
    """
    parser.add_argument("--quick", action="store_true", help="only show that the bench works")
    parser.add_argument("--gpu", action="store_true", help="on the first GPU, not on all cores")
    parser.add_argument("--out", type=Path, default=Path("bench/results"), metavar="DIR")
    arguments = parser.parse_args()
    date, machine = datetime.now(UTC).date().isoformat(), this_machine()
    with tempfile.TemporaryDirectory(prefix="gaitway-bench-") as folder:
        figures = list(measure(arguments, Path(folder)))
    run = Run(" ".join([parser.prog, *sys.argv[1:]]), date, this_commit(), machine, figures)
    show(name, run, Console(width=140))
    if not arguments.quick:
        print(f"Kept in {save(arguments.out, name, run)}.")
