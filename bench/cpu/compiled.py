"""Physics compiled for one body beside C MuJoCo, on all cores of this machine."""

from statistics import median

from bench.measure.result import Figure, Options, Result, Table, at_least
from bench.measure.runs import Run, Runs, Work
from bench.measure.statistics import spread
from core.environments import catalog

# How many times as fast as `native` each body is to be.
_TARGETS = {"ant": 10.0, "humanoid": 6.0, "rodent": 6.0, "brittle_star": 6.0}
_OTHERS = ("half_cheetah", "hopper", "walker2d", "corridor")
_NUM_ENVS = 512
_EQUAL = "equal-settings"


def measure(options: Options) -> Result:
    """Each body in its own process, which steps it by both engines in turns."""
    bodies = ["inverted_pendulum"] if options.quick else [*_TARGETS, *_OTHERS]
    covered = [body for body in bodies if "compiled" not in catalog.find(body).cannot_run]
    runs = Runs("compiled", options)
    runs.make([Work(body, "bench.ours.run_steps", _request(body, options), about_s=60) for body in covered])
    equal = _request(bodies[0], options, own_settings=True)
    runs.make([Work(_EQUAL, "bench.ours.run_steps", equal, about_s=60)])
    figures = [_figure(body, runs.done.get(body), runs.failed.get(body)) for body in bodies]
    if run := runs.done.get(_EQUAL):
        name = f"{bodies[0]}: both under the model's own solver settings"
        figures.append(Figure.of(name, spread(_quotients(run)), "×"))
    return Result(
        name="compiled",
        title="Physics compiled for one body, on the CPU",
        command="./run bench compiled",
        quick=options.quick,
        machine=runs.where(),
        figures=figures,
        table=_table(runs.done),
        rows=[
            {"run": body, "engine": engine, "control_steps_per_second": median(rates[str(_envs(options))])}
            for body, run in runs.done.items()
            for engine, rates in run["rates"].items()
        ],
        notes=[
            f"{_envs(options):,} environments under random controls, a second after their start. `native` is "
            "C MuJoCo in double precision under the model's own solver settings; `compiled` is in single "
            "precision under the settings for accelerators, as in a job.",
            *runs.notes(),
        ],
        unfinished=runs.left,
    )


def _envs(options: Options) -> int:
    return 16 if options.quick else _NUM_ENVS


def _request(body: str, options: Options, *, own_settings: bool = False) -> dict[str, object]:
    return {
        "environment": body,
        "engines": ["compiled", "native"],
        "num_envs": [_envs(options)],
        "rounds": 2 if options.quick else 7,
        "steps_per_call": 5 if options.quick else 20,
        "own_settings": own_settings,
    }


def _figure(body: str, run: Run | None, why: str | None) -> Figure:
    name = f"{body}: `compiled` ÷ `native`"
    target = at_least(_TARGETS[body]) if body in _TARGETS else None
    if run is None:
        missing = why or catalog.find(body).cannot_run.get("compiled", "not measured")
        return Figure(name=name, value=None, unit="×", target=target, missing=missing)
    return Figure.of(name, spread(_quotients(run)), "×", target)


def _quotients(run: Run) -> list[float]:
    """`compiled` over `native`, round by round."""
    ours, theirs = (next(iter(run["rates"][engine].values())) for engine in ("compiled", "native"))
    return [one / other for one, other in zip(ours, theirs, strict=True)]


def _table(done: dict[str, Run]) -> Table | None:
    if not done:
        return None
    rows = list[list[str]]()
    for body, run in done.items():
        for engine, rates in run["rates"].items():
            steps = median(next(iter(rates.values())))
            rows.append([body, f"`{engine}`", f"{steps:,.0f}", f"{run['ready_s'][engine]:.1f} s"])
    return Table(headings=["body", "engine", "control steps/s", "first loop, compiling included"], rows=rows)
