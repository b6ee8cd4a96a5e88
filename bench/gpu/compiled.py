"""Physics compiled for one body beside MuJoCo Warp, in a JAX loop on a GPU."""

from statistics import median
from typing import Any

from bench.measure import comparison, requests
from bench.measure.result import Figure, Options, Result, Table, Target, at_least, at_most
from bench.measure.runs import Run, Runs, Work
from core.environments import catalog

# Control steps per second to reach, by number of environments.
_TARGETS: dict[str, dict[int, float]] = {
    "ant": {4096: 40e6, 16_384: 100e6},
    "humanoid": {2048: 10e6, 16_384: 40e6},
    "rodent": {2048: 0.5e6},
    "corridor": {4096: 10e6},
    "brittle_star": {4096: 0.0},
    "half_cheetah": {2048: 0.0},
    "hopper": {2048: 0.0},
    "walker2d": {2048: 0.0},
}
_TIMES_WARP = {"brittle_star": 10.0}
_READY = (("compiling included", "ready_s"), ("with its code on disk", "ready_again_s"))
_READY_S = {"ant": (3.0, 0.3), "humanoid": (6.0, 0.3)}


def measure(options: Options) -> Result:
    """Each body in its own process, which steps it by both engines in turns."""
    device = requests.gpu("gpu_compiled", options)
    bodies = {"inverted_pendulum": {16: 0.0}} if options.quick else _TARGETS
    peer = "warp" if device == "gpu" else "native"
    runs = Runs("gpu_compiled", options)
    works = list[Work]()
    for body, sizes in bodies.items():
        if "compiled" in catalog.find(body).cannot_run:
            continue
        # The first number is the training's; only there is the peer worth its minutes.
        first, *others = sizes
        both = _request(body, ["compiled", peer], [first], options)
        works.append(Work(body, "bench.ours.run_steps", both, about_s=60))
        if others:
            more = _request(body, ["compiled"], others, options)
            works.append(Work(f"{body}-more", "bench.ours.run_steps", more, about_s=30))
    runs.make(works)
    return Result(
        name="gpu_compiled",
        title="Physics compiled for one body, on a GPU",
        command="./run bench gpu_compiled",
        quick=options.quick,
        machine=runs.where(),
        figures=[figure for body, sizes in bodies.items() for figure in _figures(body, sizes, runs, peer)],
        table=_table(runs.done),
        rows=comparison.step_rows(runs.done),
        notes=[
            "Physics alone in a compiled JAX loop, under random controls, a second after the bodies' start; "
            "both engines in one process, in turns. Each solves as the environment asks of it: the ant and "
            "the humanoid with up to four iterations on `compiled`, and two on `warp`.",
            *runs.notes(),
        ],
        unfinished=runs.left,
    )


def _request(body: str, engines: list[str], num_envs: list[int], options: Options) -> dict[str, Any]:
    return {
        "environment": body,
        "device": "gpu",
        "engines": engines,
        "num_envs": num_envs,
        "rounds": 2 if options.quick else 5,
        "steps_per_call": 5 if options.quick else 100,
        "own_settings": False,
    }


def _figures(body: str, sizes: dict[int, float], runs: Runs, peer: str) -> list[Figure]:
    why = runs.failed.get(body) or catalog.find(body).cannot_run.get("compiled")
    found = [
        _rate(f"{body}, {num_envs:,} environments", _of(runs, body, num_envs), why, least)
        for num_envs, least in sizes.items()
    ]
    run = runs.done.get(body)
    if run is None:
        return found
    (ours,), (theirs,) = (run["rates"][engine].values() for engine in ("compiled", peer))
    least = _TIMES_WARP.get(body)
    times = Figure(
        name=f"{body}: `compiled` ÷ `{peer}`",
        value=median(one / other for one, other in zip(ours, theirs, strict=True)),
        unit="×",
        target=at_least(least) if least else None,
    )
    ready = [
        Figure(
            name=f"{body}: first control step, {what}",
            value=run[name]["compiled"],
            unit="s",
            target=at_most(most) if most else None,
        )
        for (what, name), most in zip(_READY, _READY_S.get(body, (None, None)), strict=True)
    ]
    return [*found, times, *ready]


def _rate(name: str, rates: list[float] | None, why: str | None, least: float) -> Figure:
    target: Target | None = at_least(least) if least else None
    if rates is None:
        missing = why or "not measured"
        return Figure(name=name, value=None, unit="control steps/s", target=target, missing=missing)
    return Figure(name=name, value=median(rates), unit="control steps/s", target=target)


def _of(runs: Runs, body: str, num_envs: int) -> list[float] | None:
    for name in (body, f"{body}-more"):
        rates = runs.done.get(name, {}).get("rates", {}).get("compiled", {})
        if str(num_envs) in rates:
            return rates[str(num_envs)]
    return None


def _table(done: dict[str, Run]) -> Table | None:
    rows = [
        [
            name.removesuffix("-more"),
            f"`{engine}`",
            f"{int(num_envs):,}",
            f"{median(one):,.0f}",
            "yes" if run["same"][engine] else "no",
        ]
        for name, run in done.items()
        for engine, rates in run["rates"].items()
        for num_envs, one in rates.items()
    ]
    headings = ["body", "engine", "environments", "control steps/s", "same bits twice"]
    return Table(headings=headings, rows=rows) if rows else None
