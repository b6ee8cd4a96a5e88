"""PPO on the CPU: this project's loop against Brax's `ppo.train`, and the start from compiled programs."""

from typing import Any

from bench.measure import comparison, requests
from bench.measure.comparison import UNIT, rate
from bench.measure.requests import Settings
from bench.measure.result import Figure, Options, Picture, Result, at_least, below
from bench.measure.runs import Run, Runs, Work
from bench.measure.statistics import ratios, spread

_BODY = "ant"
_STEPS = 491_520
_EPOCHS = 4
_MJX = {"mjx": "Brax's fast settings", "mjx_equal": "equal solvers"}
_TIMEOUT_S = 600.0


def measure(options: Options) -> Result:
    """Whole runs in their own processes, alternating seed by seed; then short ones for the rest."""
    runs = Runs("training", options)
    seeds = range(options.seeds or (1 if options.quick else 3))
    given = _settings(options)
    engines = ("mjx",) if options.quick else ("mjx", "mjx_equal")
    over_mjx = {engine: _over_mjx(engine, options) for engine in engines}
    runs.make(
        [
            *_starts(options),
            *(work for seed in seeds for work in _pair(given, seed)[:: -1 if seed % 2 else 1]),
            *over_mjx.values(),
        ]
    )
    pairs = [
        (ours, brax)
        for seed in seeds
        if (ours := runs.done.get(f"ours-{seed}")) and (brax := runs.done.get(f"brax-{seed}"))
    ]
    both = {"ours": [ours for ours, _ in pairs], "Brax, same engine": [brax for _, brax in pairs]}
    peers = {engine: runs.done[engine] for engine in engines if engine in runs.done}
    return Result(
        name="training",
        title="PPO on the CPU, ant",
        command="./run bench training",
        quick=options.quick,
        machine=runs.where(),
        figures=[
            *(_figures(*both.values(), given, peers) if pairs else []),
            *_starts_figures(runs.done.get("start-warm")),
        ],
        rows=[comparison.row(name, run) for name, run in runs.done.items()],
        notes=[*_notes(given, len(pairs), peers), *runs.notes()],
        pictures=_pictures(both) if pairs else [],
        unfinished=runs.left,
    )


def _settings(options: Options) -> Settings:
    small = {"num_eval_envs": 2, "episode_length": 20} if options.quick else {}
    steps = _STEPS // 6 if options.quick else _STEPS
    # Brax evaluates once before it starts; the number of evaluations is the same.
    given = {"num_timesteps": steps, "num_evals": _EPOCHS + 1, "reset_pool_size": 0, **small}
    return requests.equal_budget("cpu", _BODY, given, epochs=_EPOCHS)


def _pair(given: Settings, seed: int) -> list[Work]:
    ours = requests.ours("cpu", _BODY, "native", given, seed=seed)
    brax = requests.brax("cpu", _BODY, "native", given, seed=seed, epochs=_EPOCHS)
    return [
        Work(f"ours-{seed}", "bench.ours.train_ppo", ours, _TIMEOUT_S, about_s=75),
        Work(f"brax-{seed}", "bench.peers.train_brax", brax, _TIMEOUT_S, about_s=75),
    ]


def _starts(options: Options) -> list[Work]:
    """A job's start, which trains one update: with nothing compiled, and with everything."""
    one_update = requests.whole_updates("cpu", _BODY, {"num_evals": 0}, 1)
    request = requests.ours("cpu", _BODY, "native", one_update)
    cold = Work(
        "start-cold", "bench.ours.train_ppo", request, _TIMEOUT_S, about_s=30, cache="start", cold=True
    )
    warm = Work(
        "start-warm", "bench.ours.train_ppo", request, _TIMEOUT_S, about_s=20, cache="start", after=cold
    )
    return [cold, warm]


def _over_mjx(engine: str, options: Options) -> Work:
    """The smallest run that has epochs after compilation."""
    num_envs, updates_per_epoch = (8, 1) if options.quick else (256, 2)
    given = {"num_envs": num_envs, "batch_size": num_envs, "num_minibatches": 1, "unroll_length": 10}
    whole = requests.whole_updates("cpu", _BODY, given, _EPOCHS * updates_per_epoch)
    request = requests.brax("cpu", _BODY, engine, whole, epochs=_EPOCHS, evaluate=False)
    return Work(engine, "bench.peers.train_brax", request, _TIMEOUT_S, about_s=60)


def _figures(ours: list[Run], brax: list[Run], given: Settings, over_mjx: dict[str, Run]) -> list[Figure]:
    our_rates, brax_rates = ([rate(run["training"]) for run in runs] for runs in (ours, brax))
    our_walls, brax_walls = ([run["wall_s"] for run in runs] for runs in (ours, brax))
    figures = [
        Figure.of("ours", spread(our_rates), UNIT),
        Figure.of("Brax, same engine", spread(brax_rates), UNIT),
        Figure.of("ours ÷ Brax, same engine", ratios(our_rates, brax_rates), "×", at_least(2)),
        Figure.of("ours, wall of the whole run", spread(our_walls), "s"),
        Figure.of("Brax, wall of the whole run", spread(brax_walls), "s"),
        Figure.of("Brax's wall ÷ ours", ratios(brax_walls, our_walls), "×"),
        Figure.of_mean("ours, return at the end", comparison.returns(ours), ""),
        Figure.of_mean("Brax, return at the end", comparison.returns(brax), ""),
        *comparison.versus("our return − Brax's", ours, brax),
        Figure.of(
            "evaluations' share of the wall, by default",
            spread([_default_share(run, given) for run in ours]),
            "%",
            below(5),
        ),
    ]
    for engine, run in over_mjx.items():
        peer = rate(run["training"])
        figures += [
            Figure(name=f"Brax over MJX-JAX, {_MJX[engine]}", value=peer, unit=UNIT),
            Figure.of(
                f"ours ÷ Brax over MJX-JAX, {_MJX[engine]}",
                spread([value / peer for value in our_rates]),
                "×",
                at_least(50),
            ),
        ]
    return figures


def _default_share(run: Run, given: Settings) -> float:
    """Per cent of its wall time that a default run would spend in evaluation, at this rate and cost."""
    default = requests.resolved("cpu", _BODY, {})
    evaluating = default.num_evals * run["evaluation_s"] / given["num_evals"]
    return 100 * evaluating / (evaluating + default.num_timesteps / rate(run["training"]))


def _starts_figures(warm: Run | None) -> list[Figure]:
    if warm is None:
        return []
    whole = warm["first_update_at"] - warm["began_at"]
    return [
        Figure(
            name="warm start, the trainer's call to its first update",
            value=warm["first_update_s"],
            unit="s",
            target=below(4),
        ),
        Figure(
            name="warm start, the process's begin to its first update", value=whole, unit="s", target=below(4)
        ),
    ]


def _pictures(both: dict[str, list[Run]]) -> list[Picture]:
    walls = comparison.wall_parts({who: runs[0] for who, runs in both.items()})
    caption = "PPO on two CPU cores, ant: return at equal steps, and where the wall of the first goes"
    panels = [comparison.by_steps(both, "ant: return at equal steps, every seed"), walls]
    return [Picture(name="training", caption=caption, panels=panels)]


def _notes(given: Settings, num_seeds: int, over_mjx: dict[str, Any]) -> list[str]:
    sizes = "; ".join(
        f"{_MJX[engine]}: {run['training'][-1][0]:,} steps in {run['training'][-1][1]:.0f} s"
        for engine, run in over_mjx.items()
    )
    return [
        "Both trainers run the same environment on the same engine with the same hyperparameters (the ant's "
        f"tuned ones for a CPU): exactly {given['num_timesteps']:,} steps, {_EPOCHS + 1} evaluations of 16 "
        f"episodes, {num_seeds} seeds. Brax runs with a shim for a JAX function that has been removed.",
        "The rate counts training alone, over the second half of the run, without compilation and "
        "evaluations. The wall time runs from the call to its return and includes everything; nothing was "
        "compiled before. "
        "Ratios are taken seed by seed. Returns are means over the seeds, ± the standard error.",
        "Brax steps each evaluation to the full episode length; ours ends with its last episode. The share "
        "of evaluations by default is what 10 of them would take of a run to the body's own budget, at the "
        "cost and the rate measured here, compilation left out.",
        "Warm start: a process with the compiled programs of an earlier one in its cache; the first update, "
        "its environment steps included, is made. The second figure includes the interpreter's start and "
        "the import of JAX.",
        "Brax over MJX-JAX is one short run for each solver setting, with 256 ants and no evaluation; its "
        f"rate is of the second half, too, and scaled up, not trained to the end ({sizes}, compilation "
        "included). Ours is taken from the runs over `native` above.",
    ]
