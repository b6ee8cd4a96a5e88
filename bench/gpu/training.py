"""Whole PPO runs on a GPU: this project's loop against Brax's `ppo.train`, from a cold and a warm cache."""

from dataclasses import dataclass
from typing import Any

from bench.measure import comparison, requests
from bench.measure.comparison import UNIT, rate
from bench.measure.requests import Settings
from bench.measure.result import Figure, Options, Picture, Result, at_least, below
from bench.measure.runs import Run, Runs, Work
from bench.measure.statistics import spread
from bench.peers.published import PUBLISHED
from core.environments.info import Device

_NUM_EVAL_ENVS = 128  # Brax's default
_SAME = "same"
_WHO = {"ours": "ours", "brax": "Brax", _SAME: "Brax on our engine"}


@dataclass(frozen=True)
class Plan:
    """num_evals: evaluations of both trainers; Brax makes its first before training."""

    environment: str
    num_timesteps: int
    num_evals: int


def compare(plan: Plan, options: Options) -> Result:
    """Run each trainer in its own process: both cold, both warm, then the other seeds, alternating.

    Ours runs on the engine that `auto` picks, Brax on MJX-JAX like its own environments, and then on ours.
    """
    name = f"gpu_{plan.environment}"
    device, environment = requests.gpu(name, options), requests.body(plan.environment, options)
    given = _settings(device, environment, plan, options)
    engine = requests.engine(device, environment, given, quick=options.quick)
    runs = Runs(name, options)
    seeds = range(options.seeds or (2 if options.quick else 3))
    # A job's defaults when it names only the body, to see what its evaluations cost.
    defaults = given if options.quick else {}
    runs.make(
        [
            *_works(device, environment, engine, given, epochs=plan.num_evals - 1, num_seeds=len(seeds)),
            Work(
                "defaults",
                "bench.ours.train_ppo",
                requests.ours(device, environment, engine, defaults),
                about_s=90,
                cache="ours",
            ),
        ]
    )
    by_seed = {
        who: [run for seed in seeds if (run := runs.done.get(f"{who}-{seed}"))]
        for who in _WHO
        if who != _SAME or engine != "mjx"
    }
    return Result(
        name=name,
        title=f"PPO on a GPU, {plan.environment}",
        command=f"./run bench {name}",
        quick=options.quick,
        machine=runs.where(),
        figures=[*_walls(runs.done), *_rates(by_seed), *_returns(by_seed), *_shares(runs.done, by_seed)],
        rows=[comparison.row(run_name, run) for run_name, run in runs.done.items()],
        notes=[*_notes(given, engine, plan.num_evals, by_seed), *runs.notes()],
        pictures=_pictures(name, runs.done, by_seed, plan.environment),
        unfinished=runs.left,
    )


def _settings(device: Device, environment: str, plan: Plan, options: Options) -> Settings:
    given = requests.settings(
        device,
        environment,
        options,
        num_evals=plan.num_evals,
        reset_pool_size=0,  # An episode starts again at its own first state, as in Brax.
        **({} if options.quick else {**PUBLISHED[environment], "num_eval_envs": _NUM_EVAL_ENVS}),
    )
    epochs = plan.num_evals - 1
    if options.quick:
        return requests.whole_updates(device, environment, given, 2 * epochs)
    wanted = {**given, "num_timesteps": plan.num_timesteps}
    return requests.equal_budget(device, environment, wanted, epochs=epochs)


def _works(
    device: Device, environment: str, engine: str, given: Settings, *, epochs: int, num_seeds: int
) -> list[Work]:
    def ours(seed: int, name: str = "", **more: Any) -> Work:
        request = requests.ours(device, environment, engine, given, seed=seed)
        return Work(name or f"ours-{seed}", "bench.ours.train_ppo", request, cache="ours", **more)

    def brax(seed: int, name: str = "", **more: Any) -> Work:
        request = requests.brax(device, environment, "mjx", given, seed=seed, epochs=epochs)
        return Work(
            name or f"brax-{seed}", "bench.peers.train_brax", request, about_s=150, cache="brax", **more
        )

    def same(seed: int) -> list[Work]:
        request = requests.brax(device, environment, engine, given, seed=seed, epochs=epochs)
        work = Work(f"{_SAME}-{seed}", "bench.peers.train_brax", request, cache=_SAME)
        return [work] if engine != "mjx" else []

    ours_cold, brax_cold = ours(0, "ours-cold", cold=True), brax(0, "brax-cold", cold=True)
    works = [ours_cold, brax_cold, brax(0, after=brax_cold), ours(0, after=ours_cold), *same(0)]
    for seed in range(1, num_seeds):
        pair = [ours(seed), brax(seed)]
        works += [*(pair if seed % 2 else pair[::-1]), *same(seed)]
    return works


def _walls(done: dict[str, Run]) -> list[Figure]:
    figures = list[Figure]()
    for temperature, run, target in (("cold", "cold", 3), ("warm", "0", 4)):
        walls = {who: done[f"{who}-{run}"]["wall_s"] for who in ("ours", "brax") if f"{who}-{run}" in done}
        figures += [
            Figure(name=f"{_WHO[who]}, wall, {temperature} cache", value=wall, unit="s")
            for who, wall in walls.items()
        ]
        figures += comparison.quotient(
            f"Brax's wall ÷ ours, {temperature} cache",
            walls.get("brax"),
            walls.get("ours"),
            at_least(target),
        )
    return figures


def _rates(by_seed: dict[str, list[Run]]) -> list[Figure]:
    rates = {who: spread([rate(run["training"]) for run in runs]) for who, runs in by_seed.items() if runs}
    medians = {who: found.median for who, found in rates.items()}
    return [
        *(Figure.of(f"{_WHO[who]}, steady", found, UNIT) for who, found in rates.items()),
        *comparison.quotient("ours ÷ Brax, steady", medians.get("ours"), medians.get("brax"), at_least(1.5)),
        *comparison.quotient("ours ÷ Brax on our engine, steady", medians.get("ours"), medians.get(_SAME)),
    ]


def _returns(by_seed: dict[str, list[Run]]) -> list[Figure]:
    figures = [
        Figure.of_mean(f"{_WHO[who]}, return at the end", comparison.returns(runs), "")
        for who, runs in by_seed.items()
        if runs
    ]
    for peer in ("brax", _SAME):
        if by_seed["ours"] and by_seed.get(peer):
            figures += comparison.versus(f"our return − that of {_WHO[peer]}", by_seed["ours"], by_seed[peer])
    return figures


def _shares(done: dict[str, Run], by_seed: dict[str, list[Run]]) -> list[Figure]:
    figures = list[Figure]()
    if run := done.get("defaults"):
        share = comparison.evaluations_share(run)
        figures.append(
            Figure(name="evaluations' share of the wall, by default", value=share, unit="%", target=below(5))
        )
    return figures + [
        Figure(name=f"{_WHO[who]}, peak device memory of JAX", value=peak / 1e9, unit="GB")
        for who, runs in by_seed.items()
        if runs and (peak := runs[0]["peak_bytes"])
    ]


def _pictures(
    name: str, done: dict[str, Run], by_seed: dict[str, list[Run]], environment: str
) -> list[Picture]:
    cold = {_WHO[who]: done[f"{who}-cold"] for who in ("ours", "brax") if f"{who}-cold" in done}
    warm = {_WHO[who]: done[f"{who}-0"] for who in ("ours", "brax") if f"{who}-0" in done}
    if not (cold and warm):
        return []
    labelled = {_WHO[who]: runs for who, runs in by_seed.items() if runs}
    caption = f"PPO on a GPU, {environment}: return against steps and against the wall, and where that goes"
    walls = {
        f"{who}, {temperature}": run
        for temperature, of in (("cold", cold), ("warm", warm))
        for who, run in of.items()
    }
    return [
        Picture(
            name=name,
            caption=caption,
            panels=[
                comparison.by_steps(labelled, f"{environment}: return at equal steps, every seed"),
                comparison.by_wall(cold, "Return against the wall, cold cache"),
                comparison.wall_parts(walls),
            ],
        )
    ]


def _notes(given: Settings, engine: str, num_evals: int, by_seed: dict[str, list[Run]]) -> list[str]:
    seeds = ", ".join(f"{_WHO[who]} {len(runs)}" for who, runs in by_seed.items())
    return [
        f"Ours runs on the engine `{engine}`, which `auto` takes there, Brax on MJX-JAX; both train the same "
        f"environment with Brax's published settings for exactly {given['num_timesteps']:,} steps, with "
        f"{num_evals} evaluations of {given['num_eval_envs']} episodes. Brax runs with a shim for a JAX "
        "function that has been removed, over this project's environments, which carry less through MJX than "
        "Brax's own do.",
        "The wall time runs from the call to its return; it includes tracing, compiling and evaluating, "
        "but not the import of JAX. The cold cache is an empty folder, also for Warp's kernels; the warm "
        "one is what the same "
        "trainer's cold run left. Both are runs of seed 0.",
        f"Returns are means over seeds ({seeds}), ± the standard error; that of the difference is the root "
        "of the sum of both squares. Each seed has one evaluation at the end.",
        "Steady: the rate of training alone over the second half of the run's reports, for each seed's run "
        "from a warm cache. Warp's own buffers are not in JAX's memory.",
        "In the picture, Brax's evaluations include their compilation; ours do not. By default: a run with "
        "the body's tuned settings, like a job that names only the body.",
    ]
