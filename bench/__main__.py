"""`python -m bench [NAME ...] [--quick] [--out DIR]`; `python -m bench report` rewrites docs/performance.md.

The training benches may be spread over several calls: with `--resume`, a call keeps the runs of earlier ones.
"""

import argparse
import subprocess
import sys
from importlib import import_module
from pathlib import Path

from rich.console import Console

from bench.measure import charts, report
from bench.measure.result import Options, Result

DEFAULT = {
    "physics": "bench.cpu.physics",
    "compiled": "bench.cpu.compiled",
    "own_models": "bench.cpu.own_models",
    "gate": "bench.cpu.gate",
    "training": "bench.cpu.training",
    "corridor": "bench.cpu.corridor",
    "q_learning": "bench.cpu.q_learning",
    "exercises": "bench.cpu.exercises",
    "record": "bench.service.record",
    "faults": "bench.service.faults",
    "service": "bench.service.costs",
    "models": "bench.service.models",
    "page": "bench.service.page",
    "replay": "bench.service.replay",
    "push": "bench.service.push",
    "live": "bench.service.live",
    "video": "bench.cpu.video",
    "demo": "bench.service.demo",
    "preparation": "bench.service.preparation",
    "largest": "bench.service.largest",
}
# These run only by name.
LONG = {
    "load": "bench.service.load",
    "outages": "bench.service.outages",
    "recovery": "bench.service.recovery",
    "soak": "bench.service.soak",
    "memory": "bench.cpu.memory",
    "egocentric": "bench.cpu.egocentric",
    "layouts": "bench.cpu.layouts",
}
ON_A_GPU = {
    "gpu_engines": "bench.gpu.engines",
    "gpu_compiled": "bench.gpu.compiled",
    "gpu_own_models": "bench.gpu.own_models",
    "gpu_returns": "bench.gpu.returns",
    "gpu_resume": "bench.gpu.resume",
    "gpu_gate": "bench.gpu.gate",
    "gpu_sac": "bench.gpu.sac",
    "gpu_ant": "bench.gpu.ant",
    "gpu_humanoid": "bench.gpu.humanoid",
    "gpu_bodies": "bench.gpu.bodies",
    "gpu_rodent": "bench.gpu.rodent",
    "gpu_corridor": "bench.gpu.corridor",
    "gpu_layouts": "bench.gpu.layouts",
    "gpu_cohort": "bench.gpu.cohort",
    "gpu_q_learning": "bench.gpu.q_learning",
    "gpu_profile": "bench.gpu.profile",
    "gpu_scaling": "bench.gpu.scaling",
}
MODULES = {**DEFAULT, **LONG, **ON_A_GPU}
PAGE, PICTURES = Path("docs/performance.md"), Path("docs/pictures")
UNFINISHED = 75


def main() -> int:
    """The exit status: 0 when every measurement was made, whether or not it reached its target.

    75 if there are runs left for another call with --resume.
    """
    given = _arguments()
    if given.names == ["report"]:
        return _report(given.out)
    names = given.names or list(DEFAULT)
    if len(names) == 1:
        return _measure(names[0], given)
    # Each in its own process: none finds JAX, its caches or its threads as another one left them.
    flags = [*(["--quick"] if given.quick else []), *(["--fresh-clone"] if given.fresh_clone else [])]
    flags += ["--resume"] if given.resume else []
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
        help=f"of {', '.join(DEFAULT)}; only by name {', '.join(LONG)}; on a GPU {', '.join(ON_A_GPU)}; or "
        "`report` alone",
    )
    parser.add_argument("--quick", action="store_true", help="only show that the bench works")
    parser.add_argument("--fresh-clone", action="store_true", help="demo: also from a clone, venv empty")
    parser.add_argument("--minutes", type=float, metavar="M", help="load, outages, soak: how long it lasts")
    parser.add_argument("--gpu", action="store_true", help="memory: of the first GPU, not of the host")
    parser.add_argument("--out", type=Path, default=Path("bench-results"), metavar="DIR")
    training = parser.add_argument_group("the training benches, one at a time")
    training.add_argument(
        "--resume", action="store_true", help="keep the runs in DIR/runs, and make those that are missing"
    )
    training.add_argument(
        "--seconds", type=float, metavar="S", help="start no run that would not end within S seconds"
    )
    training.add_argument(
        "--only", default="*", metavar="PATTERN", help="make only runs of such names, `brax-*` say"
    )
    training.add_argument("--seeds", type=int, metavar="N", help="how many of each")
    campaign = parser.add_argument_group("the campaign of faults")
    campaign.add_argument("--first", type=int, default=0, metavar="SEED", help="the first of its seeds")
    campaign.add_argument("--worlds", type=int, metavar="N", help="deployments under test side by side")
    campaign.add_argument(
        "--kinds", nargs="+", default=["faults"], help="kinds of faults: modules of tests/faults/campaign"
    )
    given = parser.parse_args()
    given.names = [name.replace("-", "_") for name in given.names]
    unknown = [name for name in given.names if name not in MODULES]
    if unknown and given.names != ["report"]:
        parser.error(f"There is no bench {unknown[0]!r}; there are {', '.join(MODULES)}.")
    if given.names != ["faults"] and (given.first or given.worlds or given.kinds != ["faults"]):
        parser.error("--first, --worlds and --kinds are about the bench `faults`: name it.")
    if len(given.names) != 1 and (given.seconds or given.seeds or given.only != "*"):
        parser.error("--seconds, --only and --seeds are about one bench: name it.")
    if given.seeds is not None and given.seeds < 1:
        parser.error("--seeds must be 1 or more.")
    return given


def _measure(name: str, given: argparse.Namespace) -> int:
    module = import_module(MODULES[name])
    options = {key: value for key, value in vars(given).items() if key in Options.model_fields}
    result: Result = module.measure(Options(**options))
    console = Console()
    report.show(result, console)
    console.print(f"Written to {result.save(given.out)}.")
    if result.unfinished:
        console.print("Not made yet, for another call with --resume: " + ", ".join(result.unfinished))
        return UNFINISHED
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
    drawn = charts.draw(results, PICTURES)
    print(f"{PAGE} shows {', '.join(result.name for result in results)}, with {len(drawn)} pictures.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
