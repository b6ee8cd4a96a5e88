"""A table that steers a brittle star, on the CPU: our Q-learning against the tutorial notebook's own loop."""

from collections.abc import Mapping, Sequence
from statistics import fmean, median
from typing import Any

from bench.measure.comparison import quotient, rate
from bench.measure.result import Bars, Figure, Line, Options, Panel, Picture, Result, at_least, at_most
from bench.measure.runs import Run, Runs, Work
from core.environments.info import Device

CONTROL_STEPS = "control steps/s"
_TABLES: Mapping[str, Mapping[str, Any]] = {
    "centralised": {},
    "decentralised": {"state_discretizer": {"kind": "arm_role"}, "action_set": {"kind": "arm_roles"}},
}
_IDENTITY = {
    "initial_table": "identity",
    "learning_rate": 0.0,
    "epsilon": {"start": 0.0, "end": 0.0},
    "num_episodes": 1,  # Rounded up to a whole round.
}
_SMALLEST: Mapping[str, Any] = {
    "options": {"num_arms": 3, "num_segments_per_arm": 1, "simulation_time": 2.0, "target_distance": 0.5},
    "settings": {"num_episodes": 4, "num_envs": 2},
}
_STEERED = 100


def measure(options: Options) -> Result:
    """Measure whole runs of a hundred episodes, the notebook's loop, and other numbers of environments."""
    runs = Runs("q_learning", options)
    env_counts = (2,) if options.quick else (1, 10, 50)
    runs.make(works(options, "cpu", "native", env_counts))
    return result("q_learning", "A brittle star steered by a table, on the CPU", runs, options, 40.0, "ours")


def works(options: Options, device: Device, engine: str, env_counts: Sequence[int]) -> list[Work]:
    """Cold and warm starts, tables that learn, the notebook's loop, other numbers of environments."""
    seeds = range(options.seeds or (1 if options.quick else 3))

    def ours(name: str, settings: Mapping[str, Any], *, seed: int = 0, steered: bool = True) -> Work:
        request = request_of(options, device, engine, settings, seed=seed, steered=steered)
        return Work(name, "bench.ours.train_star", request, about_s=90, cache="star")

    cold = Work(
        "cold",
        "bench.ours.train_star",
        request_of(options, device, engine, {}, steered=False),
        about_s=120,
        cache="start",
        cold=True,
    )
    warm = Work("warm", cold.module, cold.request, about_s=60, cache="start", after=cold)
    return [
        cold,
        warm,
        ours("identity", _IDENTITY),
        *(ours(f"{name}-{seed}", table, seed=seed) for seed in seeds for name, table in _TABLES.items()),
        Work("notebook", "bench.peers.notebook_star", _notebook(options, device), about_s=400),
        *(
            ours(f"{how}-{number}-envs", {"num_envs": number, "world_updates": how}, steered=False)
            for number in env_counts
            for how in (("mean",) if number == 1 else ("mean", "compound"))
        ),
    ]


def request_of(
    options: Options,
    device: Device,
    engine: str,
    settings: Mapping[str, Any],
    *,
    seed: int = 0,
    steered: bool = True,
) -> dict[str, Any]:
    """A request for bench.ours.train_star."""
    small = _SMALLEST if options.quick else {"options": {}, "settings": {}}
    return {
        "options": {"control": "cpg", **small["options"]},
        "settings": {**small["settings"], **settings},
        "engine": engine,
        "device": device,
        "seed": seed,
        "steered": (4 if options.quick else _STEERED) if steered else 0,
    }


def _notebook(options: Options, device: Device) -> dict[str, Any]:
    """A request for bench.peers.notebook_star; with fewer than 499 control steps where these take minutes."""
    if options.quick:
        small = {"num_arms": 3, "num_segments_per_arm": 1}
        return {**small, "steps": 2, "time_limit_s": 0.0, "seed": 0, "device": device}
    steps, limit_s = (20, 20.0) if device == "cpu" else (100, 60.0)
    return {"steps": steps, "time_limit_s": limit_s, "seed": 0, "device": device}


def result(name: str, title: str, runs: Runs, options: Options, most_s: float, fastest: str) -> Result:
    """fastest: the name of the training rate and of its run; if there is no such run, the warm one."""
    done = runs.done
    tables = {table: [run for key, run in done.items() if key.startswith(f"{table}-")] for table in _TABLES}
    return Result(
        name=name,
        title=title,
        command=f"./run bench {name.replace('_', '-')}",
        quick=options.quick,
        machine=runs.where(),
        figures=[*_rates(runs, fastest), *_walls(done, most_s), *_steering(done, tables)],
        rows=[_row(key, run) for key, run in done.items()],
        notes=[*_NOTES, *runs.notes()],
        pictures=_pictures(name, tables, {key: run for key, run in done.items() if key.endswith("-envs")}),
        unfinished=runs.left,
    )


def _rates(runs: Runs, fastest: str) -> list[Figure]:
    figures = list[Figure]()
    ours = runs.done.get(fastest) or runs.done.get("warm")
    our_rate = rate(ours["training"]) if ours and len(ours["training"]) > 1 else None
    if our_rate is not None:
        figures.append(Figure(name=f"training, {fastest}", value=our_rate, unit=CONTROL_STEPS))
    theirs = runs.done.get("notebook")
    their_rate = theirs["control_steps_per_second"] if theirs else None
    if theirs:
        figures += [
            Figure(name="the notebook's loop", value=their_rate, unit=CONTROL_STEPS),
            Figure(name="the notebook's loop, compiling", value=theirs["compile_s"], unit="s"),
        ]
    elif why := runs.failed.get("notebook"):
        figures.append(Figure(name="the notebook's loop", value=None, unit=CONTROL_STEPS, missing=why))
    return figures + quotient("ours ÷ the notebook's loop", our_rate, their_rate, at_least(1000))


def _walls(done: Mapping[str, Run], most_s: float) -> list[Figure]:
    """Wall times. There are several warm runs: the learning ones after the first find everything compiled."""
    name = "100 episodes, the process's begin to the learnt table"
    walls = {key: run["learnt_at"] - run["began_at"] for key, run in done.items() if "learnt_at" in run}
    warm = [walls[key] for key in ("warm", "centralised-1", "centralised-2") if key in walls]
    figures = list[Figure]()
    if "cold" in walls:
        figures.append(Figure(name=f"{name}, cold", value=walls["cold"], unit="s"))
    if warm:
        spread = {"value": median(warm), "low": min(warm), "high": max(warm)}
        figures.append(Figure(name=f"{name}, warm", **spread, unit="s", target=at_most(most_s)))
    return figures


def _steering(done: Mapping[str, Run], tables: Mapping[str, list[Run]]) -> list[Figure]:
    """Per cent of unseen targets that learnt tables reach, over their seeds."""
    figures = list[Figure]()
    if run := done.get("identity"):
        figures.append(
            Figure(name="targets reached, identity, not learnt", value=100 * run["reached"], unit="%")
        )
    for table, of_seeds in tables.items():
        if of_seeds:
            shares = [100 * run["reached"] for run in of_seeds]
            figures += [
                Figure(
                    name=f"targets reached, {table}",
                    value=fmean(shares),
                    low=min(shares),
                    high=max(shares),
                    unit="%",
                    target=at_least(90),
                ),
                Figure(
                    name=f"and after so long, {table}",
                    value=fmean(run["arrived_s"] for run in of_seeds),
                    unit="s of simulated time",
                ),
            ]
    return figures


def _row(name: str, run: Run) -> dict[str, str | int | float | bool | None]:
    kept = {key: value for key, value in run.items() if isinstance(value, str | int | float | bool | None)}
    listed = {key: str(run[key]) for key in ("training", "rewards", "phases", "greedy") if key in run}
    return {"run": name, **kept, **listed}


def _pictures(name: str, tables: Mapping[str, list[Run]], envs: Mapping[str, Run]) -> list[Picture]:
    panels: list[Panel | Bars] = [
        Panel(
            title=title,
            x="episodes of the agent",
            y="return, m nearer to the target",
            lines=[Line(label=label, points=points) for label, points in drawn],
        )
        for title, lines in (
            ("Learning to steer, every seed", [(key, run) for key, of in tables.items() for run in of]),
            ("How the environments' updates are combined", list(envs.items())),
        )
        # If all episodes are one round, there is a point and no curve.
        if (drawn := [(label, points) for label, run in lines if len(points := _by_episode(run)) > 1])
    ]
    caption = "A brittle star learns to steer: return by episodes, exploration included"
    return [Picture(name=name, caption=caption, panels=panels)] if panels else []


def _by_episode(run: Run) -> list[tuple[float, float]]:
    return [(run["episodes"] * step / run["control_steps"], value) for step, value in run["rewards"]]


_NOTES = (
    "Ours: `brittle_star` with `control: cpg` and the values tuned for it: 100 episodes of 20 s, targets 3 "
    "m away in random directions. A control step is one action of one environment, ten physics steps "
    "of 4 ms; the rate is that of the run's second half, its learning included.",
    "The notebook's loop: biorobot's MJX environment, one at a time, a decision in every control step, "
    "its episode and its learning compiled (`bench/peers/notebook_star.py`), with biorobot's one iteration "
    "of Newton; ours solves to the end on `native` and with 4 iterations on `warp`. Its rate is that after "
    "the first call, which compiles, and its episodes are shortened if they would take minutes.",
    f"Targets reached: of {_STEERED} episodes of 20 s from another seed, without exploration; of the learnt "
    "tables the mean, the least and the greatest over the seeds. Decentralised: each arm reads for itself "
    "how far the target's sector is and picks its own role, all from one table.",
)
