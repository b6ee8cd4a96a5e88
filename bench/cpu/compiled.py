"""Physics compiled for one body beside C MuJoCo, on all cores of this machine; PPO and Q-learning on both."""

from collections.abc import Sequence

from bench.cpu import q_learning
from bench.measure import comparison, requests
from bench.measure.comparison import UNIT, rate
from bench.measure.engine_steps import ENGINES, quotients, steps_table
from bench.measure.result import Figure, Options, Result, at_least, at_most
from bench.measure.runs import Run, Runs, Work
from bench.measure.statistics import ratios, spread
from core.environments import catalog

# How many times as fast as `native` each body is to be.
_TARGETS = {"ant": 10.0, "humanoid": 6.0, "rodent": 6.0, "brittle_star": 6.0}
_OTHERS = ("half_cheetah", "hopper", "walker2d", "corridor")
_NUM_ENVS = 512
# For these, `auto` decides by the number of environments; a rollout may have one.
_FEWER = (1, 4, 16, 64, 256)
_EQUAL = "equal-settings"
_TRAINED, _STEPS, _NUM_EVALS = "ant", 491_520, 5


def measure(options: Options) -> Result:
    """Each body in its own process, which steps it by both engines in turns; then pairs of trainings."""
    bodies = ["inverted_pendulum"] if options.quick else [*_TARGETS, *_OTHERS]
    covered = [body for body in bodies if "compiled" not in catalog.find(body).cannot_run]
    seeds = range(options.seeds or (1 if options.quick else 3))
    runs = Runs("compiled", options)
    runs.make([Work(body, "bench.ours.run_steps", _request(body, options), about_s=60) for body in covered])
    equal = _request(bodies[0], options, own_settings=True)
    runs.make([Work(_EQUAL, "bench.ours.run_steps", equal, about_s=60)])
    runs.make([work for seed in seeds for work in _trainings(seed, options)])
    runs.make(_steered(options))
    figures = [_figure(body, runs.done.get(body), runs.failed.get(body)) for body in bodies]
    if run := runs.done.get(_EQUAL):
        name = f"{bodies[0]}: both under the model's own solver settings"
        figures.append(Figure.of(name, spread(quotients(run, str(_envs(options)))), "×"))
    trained = [pair for seed in seeds if (pair := _pair(runs.done, seed))]
    steps = {body: run for body in bodies if (run := runs.done.get(body))}
    return Result(
        name="compiled",
        title="Physics compiled for one body, on the CPU",
        command="./run bench compiled",
        quick=options.quick,
        machine=runs.where(),
        figures=[
            *figures,
            *_training_figures(requests.body(_TRAINED, options), trained),
            *_steered_figures(runs.done),
        ],
        table=steps_table(steps),
        rows=[
            *comparison.step_rows({name: run for name, run in runs.done.items() if "rates" in run}),
            *(comparison.row(name, run) for name, run in runs.done.items() if "training" in run),
        ],
        notes=[*_notes(options, len(trained)), *runs.notes()],
        unfinished=runs.left,
    )


def _envs(options: Options) -> int:
    return 16 if options.quick else _NUM_ENVS


def _request(body: str, options: Options, *, own_settings: bool = False) -> dict[str, object]:
    fewer = () if own_settings else ((1,) if options.quick else _FEWER)
    return {
        "environment": body,
        "engines": list(ENGINES),
        "num_envs": [_envs(options), *fewer],
        "rounds": 2 if options.quick else 7,
        "steps_per_call": 5 if options.quick else 20,
        "own_settings": own_settings,
    }


def _trainings(seed: int, options: Options) -> list[Work]:
    """One on each engine, with nothing compiled before; each second pair in reverse order."""
    body = requests.body(_TRAINED, options)
    given = requests.settings(
        "cpu", body, options, num_timesteps=160 if options.quick else _STEPS, num_evals=_NUM_EVALS
    )
    works = [
        Work(
            f"ppo-{engine}-{seed}",
            "bench.ours.train_ppo",
            requests.ours("cpu", body, engine, given, seed=seed),
            about_s=100,
        )
        for engine in ENGINES
    ]
    return works[:: -1 if seed % 2 else 1]


def _steered(options: Options) -> list[Work]:
    """Q-learning on a brittle star, on each engine."""
    return [
        Work(
            f"star-{engine}",
            "bench.ours.train_star",
            q_learning.request_of(options, "cpu", engine, {}, steered=False),
            about_s=60,
            cache=f"star-{engine}",
        )
        for engine in ENGINES
    ]


def _steered_figures(done: dict[str, Run]) -> list[Figure]:
    rates = [rate(run["training"]) for engine in ENGINES if (run := done.get(f"star-{engine}"))]
    if len(rates) < len(ENGINES):
        return []
    ours, theirs = rates
    unit = q_learning.CONTROL_STEPS
    return [
        Figure(name="brittle star, Q-learning on `compiled`", value=ours, unit=unit, target=at_least(10_000)),
        Figure(name="brittle star, Q-learning on `native`", value=theirs, unit=unit),
        Figure(name="brittle star, Q-learning: `compiled` ÷ `native`", value=ours / theirs, unit="×"),
    ]


def _figure(body: str, run: Run | None, why: str | None) -> Figure:
    name = f"{body}: `compiled` ÷ `native`"
    target = at_least(_TARGETS[body]) if body in _TARGETS else None
    if run is None:
        missing = why or catalog.find(body).cannot_run.get("compiled", "not measured")
        return Figure(name=name, value=None, unit="×", target=target, missing=missing)
    most = max(run["rates"]["native"], key=int)
    return Figure.of(name, spread(quotients(run, most)), "×", target)


def _pair(done: dict[str, Run], seed: int) -> tuple[Run, Run] | None:
    """The trainings on `compiled` and on `native`."""
    ours, theirs = (done.get(f"ppo-{engine}-{seed}") for engine in ENGINES)
    return (ours, theirs) if ours and theirs else None


def _training_figures(body: str, pairs: Sequence[tuple[Run, Run]]) -> list[Figure]:
    """Rates, walls and the first update, pair by pair; returns over seeds."""
    if not pairs:
        return []
    ours, theirs = ([pair[side] for pair in pairs] for side in (0, 1))
    rates = [[rate(run["training"]) for run in runs] for runs in (ours, theirs)]
    walls, starts = (
        [[run[name] for run in runs] for runs in (ours, theirs)] for name in ("wall_s", "first_update_s")
    )
    return [
        Figure.of(f"{body}, PPO on `compiled`", spread(rates[0]), UNIT),
        Figure.of(f"{body}, PPO on `native`", spread(rates[1]), UNIT),
        Figure.of(f"{body}, PPO: `compiled` ÷ `native`", ratios(*rates), "×", at_least(1)),
        Figure.of(
            "wall of the whole run, `native` ÷ `compiled`", ratios(walls[1], walls[0]), "×", at_least(1)
        ),
        Figure.of("first update on `compiled`", spread(starts[0]), "s"),
        Figure.of(
            "first update, nothing compiled before: `compiled` ÷ `native`", ratios(*starts), "×", at_most(1.1)
        ),
        Figure.of_mean("return at the end on `compiled`", comparison.returns(ours), ""),
        Figure.of_mean("return at the end on `native`", comparison.returns(theirs), ""),
        *comparison.versus("return on `compiled` − that on `native`", ours, theirs),
    ]


def _notes(options: Options, num_pairs: int) -> list[str]:
    return [
        "Environments under random controls, a second after their start; the figures are of "
        f"{_envs(options):,}. `native` is C MuJoCo in double precision under the model's own solver "
        "settings; `compiled` is in single precision under the settings for accelerators, as in a job.",
        f"PPO: {num_pairs} pairs of whole runs under the tuned settings for a CPU, {_STEPS:,} steps and "
        f"{_NUM_EVALS} evaluations, each in a process that finds nothing compiled. The rate counts training "
        "alone, over the second half of the run. The first update is timed from the trainer's call.",
    ]
