"""SAC against PPO, each under its tuned settings for a GPU: a body with slow physics, and one with fast."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from bench.measure import requests
from bench.measure.marks import NUM_EPISODES, ON_A_GPU, Mark
from bench.measure.result import Figure, Line, Options, Panel, Picture, Result, Table, at_most
from bench.measure.runs import Run, Runs, Work

_SEEDS = 2


@dataclass(frozen=True)
class _Body:
    """A body's way to a mark. every_steps: from one evaluation to the next, by algorithm. most_s: seconds of
    training after which a run is cut off; wanted_s: in which it is to be at the mark."""

    name: str
    mark: Mark
    every_steps: Mapping[str, int]
    num_evals: int
    most_s: float
    wanted_s: float | None = None


_BODIES = [
    _Body("rodent", Mark("eval/forward_speed", 2.5, "m/s"), {"sac": 1_400_000, "ppo": 3_000_000}, 10, 90, 60),
    _Body("humanoid", ON_A_GPU["humanoid"], {"sac": 500_000, "ppo": 2_000_000}, 20, 45),
]


def measure(options: Options) -> Result:
    """Each body under both algorithms, each seed in a process of its own."""
    device = requests.gpu("gpu_sac", options)
    bodies = _BODIES[:1] if options.quick else _BODIES
    runs = Runs("gpu_sac", options)
    runs.make(work for body in bodies for work in _works(device, body, options))
    pictures = [_picture(body, runs.done) for body in bodies]
    return Result(
        name="gpu_sac",
        title="SAC against PPO on a GPU",
        command="./run bench gpu_sac",
        quick=options.quick,
        machine=runs.where(),
        figures=[figure for body in bodies for figure in _figures(body, runs)],
        table=_table(bodies, runs.done),
        rows=[
            {"run": name, "steps": steps, "value": value, "training_s": at, "seconds": seconds}
            for name, run in runs.done.items()
            for (steps, value, seconds), at in zip(run["curve"], run["trained_s"], strict=True)
        ],
        notes=[
            f"An evaluation has {NUM_EPISODES} episodes. The mark is reached at the first that has it as its "
            "mean, if a second one from other starts has it, too. Seconds of training leave evaluations, "
            "tracing and compiling out.",
            "Both algorithms train under their tuned settings on the engine that `auto` takes.",
            *runs.notes(),
        ],
        pictures=[one for one in pictures if one],
        unfinished=runs.left,
    )


def _works(device: Any, body: _Body, options: Options) -> list[Work]:
    trained = requests.body(body.name, options)
    found = list[Work]()
    for algorithm in body.every_steps:
        first: Work | None = None
        for seed in range(options.seeds or (1 if options.quick else _SEEDS)):
            request = _request(device, trained, body, algorithm, options, seed)
            work = Work(
                f"{body.name}-{algorithm}-{seed}",
                "bench.ours.reach_mark",
                request,
                about_s=60,
                cache=f"{algorithm}-{body.name}",
                cold=first is None,
                after=first,
            )
            first = first or work
            found.append(work)
    return found


def _request(
    device: Any, trained: str, body: _Body, algorithm: str, options: Options, seed: int
) -> dict[str, Any]:
    steps = body.every_steps[algorithm] * body.num_evals
    given = {"num_timesteps": steps, "num_evals": body.num_evals, "num_eval_envs": NUM_EPISODES}
    mark = body.mark
    if options.quick:
        given = {"num_timesteps": 5_120, "num_evals": 2, "num_eval_envs": 2, "episode_length": 20}
        given |= {"min_replay_size": 128} if algorithm == "sac" else {}
        mark = Mark("eval/episode_reward", 1e9, "")
    engine = requests.engine(device, trained, {}, quick=options.quick)
    request = requests.ours(device, trained, engine, {"kind": algorithm, **given}, seed=seed)
    return {**request, "mark": mark.in_request(), "most_s": body.most_s}


def _figures(body: _Body, runs: Runs) -> list[Figure]:
    found = list[Figure]()
    for algorithm in body.every_steps:
        of_it = _of(body, algorithm, runs.done)
        failed = [why for name, why in runs.failed.items() if name.startswith(f"{body.name}-{algorithm}-")]
        target = at_most(body.wanted_s) if body.wanted_s and algorithm == "sac" else None
        until = f"{body.mark.least:g} {body.mark.unit}".strip()
        seeds = f"the worst of {len(of_it)} seeds" if len(of_it) > 1 else "one seed"
        name = f"{body.name}, {algorithm.upper()}: training until {until}, {seeds}"
        there = [run["training_s"] for run in of_it if run["reached_s"] is not None]
        worst, missing = None, "not run"
        if of_it and len(there) == len(of_it):
            worst, missing = max(there), None
        elif failed or of_it:
            missing = (failed or [f"{len(of_it) - len(there)} of {len(of_it)} runs did not reach it"])[0]
        found.append(Figure(name=name, value=worst, unit="s", target=target, missing=missing))
    return found


def _of(body: _Body, algorithm: str, done: Mapping[str, Run]) -> list[Run]:
    return [run for name, run in done.items() if name.startswith(f"{body.name}-{algorithm}-")]


def _table(bodies: list[_Body], done: Mapping[str, Run]) -> Table | None:
    rows = [
        [
            name,
            f"{steps:,}",
            f"{at:.1f}",
            f"{value:,.2f} {body.mark.unit}".strip(),
            f"{length:,.0f}",
        ]
        for body in bodies
        for name, run in done.items()
        if name.startswith(f"{body.name}-")
        for (steps, value, _), at, length in zip(run["curve"], run["trained_s"], run["lengths"], strict=True)
    ]
    headings = ["run", "steps", "seconds of training", "evaluation", "steps of an episode"]
    return Table(headings=headings, rows=rows) if rows else None


def _picture(body: _Body, done: Mapping[str, Run]) -> Picture | None:
    lines = [
        Line(
            label=algorithm.upper(),
            points=[(at, value) for (_, value, _), at in zip(run["curve"], run["trained_s"], strict=True)],
        )
        for algorithm in body.every_steps
        for run in _of(body, algorithm, done)
    ]
    if not lines:
        return None
    metric = f"speed, {body.mark.unit}" if body.mark.unit else "return"
    return Picture(
        name=f"gpu_sac_{body.name}",
        caption=f"The {body.name}'s {metric} against seconds of training, each seed a curve",
        panels=[Panel(title=body.name, x="seconds of training", y=metric, lines=lines)],
    )
