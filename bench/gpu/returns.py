"""Returns of bodies that learn on compiled physics, beside MuJoCo Warp, at equal steps."""

from bench.measure import comparison, requests
from bench.measure.result import Figure, Options, Result, Table
from bench.measure.runs import Run, Runs, Work
from bench.measure.statistics import Estimate
from core.environments.info import Device

_STEPS = {"ant": 30e6, "humanoid": 20e6, "half_cheetah": 20e6, "hopper": 20e6, "walker2d": 20e6}
_ENGINES = ("compiled", "warp")
_NUM_EVALS = 3
# The card is shared: equal steps are compared here, not equal times.
_AT_ONCE = 4


def measure(options: Options) -> Result:
    """Three seeds of each body and engine; all of `compiled` first, which takes the least time."""
    device = requests.gpu("gpu_returns", options)
    bodies = ["inverted_pendulum"] if options.quick else list(_STEPS)
    engines = ("compiled", "native") if device == "cpu" else _ENGINES
    seeds = range(options.seeds or (2 if options.quick else 3))
    runs = Runs("gpu_returns", options)
    runs.make_together(
        (
            _work(device, body, engine, seed, options)
            for engine in engines
            for seed in seeds
            for body in bodies
        ),
        at_once=1 if options.quick else _AT_ONCE,
    )
    found = {
        (body, engine): [run for seed in seeds if (run := runs.done.get(f"{body}-{engine}-{seed}"))]
        for body in bodies
        for engine in engines
    }
    return Result(
        name="gpu_returns",
        title="Returns on compiled physics",
        command="./run bench gpu_returns",
        quick=options.quick,
        machine=runs.where(),
        figures=[figure for body in bodies for figure in _figures(body, engines, found)],
        table=_table(found),
        rows=[comparison.row(name, run) for name, run in runs.done.items()],
        notes=[
            "PPO under the tuned settings for a GPU, every episode from its own first state; returns of the "
            "last of two evaluations, over seeds.",
            *runs.notes(),
        ],
        unfinished=runs.left,
    )


def _work(device: Device, body: str, engine: str, seed: int, options: Options) -> Work:
    few = {} if options.quick else {"num_eval_envs": 128}
    given = requests.settings(device, body, options, num_evals=_NUM_EVALS, reset_pool_size=0, **few)
    if options.quick:
        given = requests.whole_updates(device, body, given, 2 * (_NUM_EVALS - 1))
    else:
        wanted = {**given, "num_timesteps": int(_STEPS[body])}
        given = requests.equal_budget(device, body, wanted, epochs=_NUM_EVALS - 1)
    request = requests.ours(device, body, engine, given, seed=seed)
    about_s = 60.0 if engine == "compiled" else 150.0
    return Work(f"{body}-{engine}-{seed}", "bench.ours.train_ppo", request, about_s=about_s, cache=engine)


def _figures(body: str, engines: tuple[str, ...], found: dict[tuple[str, str], list[Run]]) -> list[Figure]:
    ours, theirs = (found[body, engine] for engine in engines)
    if not ours or not theirs:
        return []
    return comparison.versus(f"{body}: return on `{engines[0]}` − on `{engines[1]}`", ours, theirs)


def _table(found: dict[tuple[str, str], list[Run]]) -> Table | None:
    rows = list[list[str]]()
    for (body, engine), runs in found.items():
        if runs:
            value: Estimate = comparison.returns(runs)
            error = "" if value.error is None else f" ± {value.error:,.0f}"
            rows.append([body, f"`{engine}`", f"{runs[0]['training'][-1][0]:,}", f"{value.mean:,.0f}{error}"])
    return Table(headings=["body", "engine", "steps", "return"], rows=rows) if rows else None
