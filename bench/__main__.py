"""`python -m bench [NAME ...] [--quick] [--out DIR]`; `python -m bench report` renews docs/performance.md."""

import argparse
import subprocess
import sys
from importlib import import_module
from pathlib import Path

from rich.console import Console

from bench import report
from bench.result import Options, Result

NAMES = ("physics", "training", "service", "video", "demo")
ON_A_GPU = ("gpu_ant", "gpu_humanoid", "gpu_scaling")
PAGE = Path("docs/performance.md")


def main() -> int:
    """The exit status: 0 when every measurement was made, whether or not it reached its target."""
    given = _arguments()
    if given.names == ["report"]:
        return _report(given.out)
    names = given.names or list(NAMES)
    if len(names) == 1:
        return _measure(names[0], given)
    # Each in a process of its own: none finds JAX, its caches or its threads as another one left them.
    flags = [*(["--quick"] if given.quick else []), *(["--fresh-clone"] if given.fresh_clone else [])]
    commands = [[sys.executable, "-m", "bench", name, "--out", str(given.out), *flags] for name in names]
    failed = [
        name
        for name, command in zip(names, commands, strict=True)
        if subprocess.run(command, check=False).returncode
    ]
    if failed:
        print(f"Not measured, for the reasons above: {', '.join(failed)}.", file=sys.stderr)
    return 1 if failed else 0


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="bench", description=__doc__)
    parser.add_argument(
        "names",
        nargs="*",
        metavar="NAME",
        help=f"of {', '.join(NAMES)}; on a GPU {' and '.join(ON_A_GPU)}; or `report` alone",
    )
    parser.add_argument("--quick", action="store_true", help="only show that the bench works")
    parser.add_argument("--fresh-clone", action="store_true", help="demo: also from a clone, venv empty")
    parser.add_argument("--out", type=Path, default=Path("bench-results"), metavar="DIR")
    given = parser.parse_args()
    unknown = [name for name in given.names if name not in (*NAMES, *ON_A_GPU)]
    if unknown and given.names != ["report"]:
        parser.error(f"There is no bench {unknown[0]!r}; there are {', '.join((*NAMES, *ON_A_GPU))}.")
    return given


def _measure(name: str, given: argparse.Namespace) -> int:
    module = import_module(f"bench.{name}")
    result: Result = module.measure(Options(quick=given.quick, fresh_clone=given.fresh_clone))
    console = Console()
    report.show(result, console)
    console.print(f"Written to {result.save(given.out)}.")
    return 0


def _report(folder: Path) -> int:
    results = report.load(folder)
    if not results:
        print(f"There are no results in {folder}; run `./run bench` first.", file=sys.stderr)
        return 1
    try:
        PAGE.write_text(report.filled(PAGE.read_text(), results))
    except ValueError as error:
        print(error, file=sys.stderr)
        return 1
    print(f"{PAGE} shows {', '.join(result.name for result in results)}.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
