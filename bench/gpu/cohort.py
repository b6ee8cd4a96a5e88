"""Seeds of one setting that are trained together, beside one that trains alone: what the whole costs."""

from bench.measure import comparison, requests
from bench.measure.comparison import quotient
from bench.measure.result import Options, Result, Table, at_most
from bench.measure.runs import Run, Runs, Work
from core.environments.info import Device

_ENVIRONMENT = "ant"
_SIZES = (4, 16)
_TARGETS = {16: 3.0}


def measure(options: Options) -> Result:
    """One run alone, then cohorts; each first with no program compiled, then again with those it left."""
    device, body = requests.gpu("gpu_cohort", options), requests.body(_ENVIRONMENT, options)
    sizes = (2,) if options.quick else _SIZES
    runs = Runs("gpu_cohort", options)
    runs.make(work for size in (1, *sizes) for work in _works(device, body, size, options))
    figures = [
        figure
        for kind in ("warm", "cold")
        for size in sizes
        for figure in quotient(
            f"{size} seeds together ÷ one alone, wall, {kind}",
            _wall(runs.done.get(f"{size}-{kind}")),
            _wall(runs.done.get(f"1-{kind}")),
            at_most(_TARGETS[size]) if kind == "warm" and size in _TARGETS else None,
        )
    ]
    return Result(
        name="gpu_cohort",
        title="Trials trained together",
        command="./run bench gpu_cohort",
        quick=options.quick,
        machine=runs.where(),
        figures=figures,
        table=_table(runs),
        rows=[comparison.row(name, run) for name, run in runs.done.items()],
        notes=[
            "PPO under the tuned settings for a GPU and the default budget, evaluations included: from the "
            "call that makes the run, or the cohort, to its end. The service adds the members' processes and "
            "videos.",
            *runs.notes(),
        ],
        unfinished=runs.left,
    )


def _works(device: Device, body: str, size: int, options: Options) -> tuple[Work, Work]:
    given = requests.settings(device, body, options)
    if options.quick:
        given = requests.whole_updates(device, body, given, 4)
    request = requests.ours(device, body, requests.engine(device, body, given, quick=options.quick), given)
    module = "bench.ours.train_ppo"
    if size > 1:
        del request["seed"]
        request, module = {**request, "seeds": list(range(size))}, "bench.ours.train_cohort"
    cold = Work(f"{size}-cold", module, request, cache=str(size), cold=True)
    return cold, Work(f"{size}-warm", module, request, cache=str(size), after=cold)


def _wall(run: Run | None) -> float | None:
    return None if run is None else run["wall_s"]


def _table(runs: Runs) -> Table | None:
    rows = [
        [
            name.partition("-")[0],
            name.partition("-")[2],
            f"{run['wall_s']:.1f} s",
            f"{run['phases'].get('trace', 0) + run['phases'].get('compile', 0):.1f} s",
            f"{run['training'][-1][1]:.1f} s",
            f"{run['rewards'][-1][1]:,.0f}" if run["rewards"] else "",
        ]
        for name, run in runs.done.items()
    ]
    headings = ["seeds", "programs", "wall", "of it compiling", "training", "mean return at the end"]
    return Table(headings=headings, rows=rows) if rows else None
