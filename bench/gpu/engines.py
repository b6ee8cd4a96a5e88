"""Finds the fastest engine for each body on a GPU machine: the basis of `EnvironmentInfo.on_a_gpu`."""

from statistics import median

from bench.measure import comparison, requests
from bench.measure.comparison import rate
from bench.measure.report import number
from bench.measure.result import Bars, Figure, Options, Picture, Result, Table, at_least
from bench.measure.runs import Run, Runs, Work
from core.environments import catalog
from core.environments.info import Device
from core.physics.availability import EngineName

_BODIES = (
    *("ant", "humanoid", "half_cheetah", "hopper", "walker2d"),
    *("rodent", "reacher", "inverted_pendulum"),
)
_ENGINES: tuple[EngineName, ...] = ("compiled", "warp", "mjx", "native")
_UPDATES = 12
_MAX_TRAINING_S = 10.0
_PHYSICS_S = 3.0
_TIMEOUT_S = 560.0
_AT_ONCE = 4
# They compile for minutes; gpu_rodent and gpu_compiled measure their physics.
_LEFT_OUT = {("rodent", "mjx"), ("rodent", "compiled")}


def measure(options: Options) -> Result:
    """Measure each body and engine in its own process; `native`, which hardly competes, comes last."""
    device = requests.gpu("gpu_engines", options)
    bodies = [body for body in _BODIES if body in catalog.ENVIRONMENTS]
    bodies = ["inverted_pendulum"] if options.quick else bodies
    # On a CPU, where the bench is only tried out, Warp's kernels would take minutes to compile.
    on_device: list[EngineName] = ["compiled", "warp", "mjx"] if device == "gpu" else ["compiled", "mjx"]
    pairs: list[tuple[str, EngineName]] = [
        *(pair for body in bodies for engine in on_device if (pair := (body, engine)) not in _LEFT_OUT),
        *((body, "native") for body in bodies),
    ]
    taken = {
        body: requests.engine(device, body, _settings(device, body, options), quick=options.quick)
        for body in bodies
    }
    runs = Runs("gpu_engines", options)
    runs.make_together(
        (_work(device, body, engine, options) for body, engine in pairs), at_once=_AT_ONCE, in_turns=True
    )
    rates = {name: rate(run["training"]) for name, run in runs.done.items()}
    return Result(
        name="gpu_engines",
        title="Engines on a GPU machine, every body",
        command="./run bench gpu_engines",
        quick=options.quick,
        machine=runs.where(),
        figures=[figure for body in bodies for figure in _figures(body, taken[body], rates)],
        table=_table(bodies, runs, rates, taken),
        rows=[
            comparison.row(name, run, num_envs=run["num_envs"], physics_steps_per_second=_physics(run))
            for name, run in runs.done.items()
        ],
        notes=[*_notes(), *runs.notes()],
        pictures=_pictures(bodies, rates),
        unfinished=runs.left,
    )


def _settings(device: Device, body: str, options: Options) -> requests.Settings:
    return requests.settings(device, body, options, num_evals=0)


def _work(device: Device, body: str, engine: EngineName, options: Options) -> Work:
    given = requests.whole_updates(device, body, _settings(device, body, options), _UPDATES)
    request = {
        **requests.ours(device, body, engine, given),
        "most_training_s": _MAX_TRAINING_S,
        "epoch_s": 0.25,
        "physics_s": 0.1 if options.quick else _PHYSICS_S,
    }
    # Each compiles its programs afresh; they share only Warp's kernels in this folder.
    return Work(f"{body}-{engine}", "bench.ours.run_engine", request, timeout_s=_TIMEOUT_S, cache=engine)


def _physics(run: Run) -> float:
    return median(run["physics"])


def _figures(body: str, taken: str, rates: dict[str, float]) -> list[Figure]:
    """Whether `auto` picks the fastest of the measured engines."""
    measured = {engine: rates[f"{body}-{engine}"] for engine in _ENGINES if f"{body}-{engine}" in rates}
    if taken not in measured or len(measured) < 2:
        return []
    share = measured[taken] / max(measured.values())
    name = f"{body}: `{taken}`, which `auto` takes, ÷ the fastest in training"
    return [Figure(name=name, value=share, unit="×", target=at_least(0.9))]


def _table(bodies: list[str], runs: Runs, rates: dict[str, float], taken: dict[str, EngineName]) -> Table:
    headings = [
        *("Body", "Environments", "Engine", "Physics, steps/s", "Training, steps/s", "Physics ÷ training"),
        *("Trace, s", "Compile, s", "First update, s"),
    ]
    rows = list[list[str]]()
    for body in bodies:
        best = max((rates.get(f"{body}-{engine}", 0.0) for engine in _ENGINES), default=0.0)
        for engine in _ENGINES:
            name = f"{body}-{engine}"
            label = f"`{engine}`{', `auto`' if taken[body] == engine else ''}"
            if run := runs.done.get(name):
                training = number(rates[name])
                rows.append(
                    [
                        *(body, str(run["num_envs"]), label, number(_physics(run))),
                        f"**{training}**" if rates[name] == best else training,
                        f"{_physics(run) / rates[name]:.2f}",
                        *(f"{run['phases'][phase]:.1f}" for phase in ("trace", "compile", "first_update")),
                    ]
                )
            elif why := runs.failed.get(name):
                rows.append([body, "", label, f"failed: {why}", "", "", "", "", ""])
    return Table(headings=headings, rows=rows)


def _pictures(bodies: list[str], rates: dict[str, float]) -> list[Picture]:
    if not rates:
        return []
    series = {f"{engine}": [rates.get(f"{body}-{engine}") for body in bodies] for engine in _ENGINES}
    bars = Bars(title="Training under the tuned settings", unit="steps/s", groups=bodies, series=series)
    return [
        Picture(
            name="gpu_engines",
            caption="Training steps per second on a GPU, by body and engine",
            panels=[bars],
        )
    ]


def _notes() -> list[str]:
    return [
        f"Training: {_UPDATES} updates under the body's tuned settings for a GPU, or as many as begin in "
        f"{_MAX_TRAINING_S:.0f} s, without evaluations; the rate is of the second half. Physics: the same "
        "number of environments under random actions, reset after each fall, without networks; the median "
        "of several seconds. A step is one action of one environment. `native` steps on the host's cores, "
        "the learner is on the GPU. The fastest training of a body is in bold.",
        f"Programs were compiled from an empty cache, {_AT_ONCE} runs at once; Warp's kernels are compiled "
        "in the first "
        "update of the bench's first run on `warp`, and kept for the others. The rodent's physics on `mjx` "
        "is in gpu_rodent, that on `compiled` in gpu_compiled: its training compiles for minutes.",
    ]
