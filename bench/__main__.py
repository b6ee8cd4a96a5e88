"""`./run bench NAME [PART ...]` measures, prints a table, and keeps it in bench/results/NAME.json."""

import argparse
import shlex
import sys
from datetime import UTC, datetime
from importlib import import_module
from pathlib import Path
from types import ModuleType

from rich.console import Console

from bench.machine import this_commit, this_machine
from bench.summary import Run, save, show

NAMES = ("physics", "train", "service", "recovery", "turns", "demo")


def main() -> int:
    """The exit status: 0 when every measurement was made, whether or not it reached its target."""
    given = sys.argv[1:]
    modules = {name: import_module(f"bench.{name}") for name in NAMES}
    arguments = parser(modules).parse_args(given)
    machine, date = this_machine(), datetime.now(UTC).date().isoformat()
    # Once: most benches yield their figures.
    figures = tuple(modules[arguments.name].measure(arguments))
    command = shlex.join(["./run", "bench", *_without_out(given)])
    run = Run(command, date, this_commit(), machine, figures)
    console = Console()
    show(arguments.name, run, console)
    if arguments.quick:
        console.print("This only shows that the bench works: the numbers say nothing, and are not kept.")
    else:
        console.print(f"Kept in {save(arguments.out, arguments.name, run)}.")
    return 0


def parser(modules: dict[str, ModuleType]) -> argparse.ArgumentParser:
    """The command line; each bench adds its own arguments."""
    whole = argparse.ArgumentParser(prog="./run bench", description=__doc__)
    names = whole.add_subparsers(dest="name", required=True, metavar="NAME")
    for name, module in modules.items():
        own = names.add_parser(name, help=(module.__doc__ or "").splitlines()[0], description=module.__doc__)
        own.add_argument("--quick", action="store_true", help="only show that the bench works")
        own.add_argument("--out", type=Path, default=Path("bench/results"), metavar="DIR")
        module.add_arguments(own)
    return whole


def _without_out(given: list[str]) -> list[str]:
    """The arguments that decide what is measured."""
    kept = list[str]()
    following = iter(given)
    for one in following:
        if one == "--out":
            next(following)
        elif not one.startswith("--out="):
            kept.append(one)
    return kept


if __name__ == "__main__":
    sys.exit(main())
