"""The star in one line, and the exercises of its notebook: every job of examples/exercises, each whole."""

import json
from pathlib import Path
from typing import Any

from bench.measure.result import Figure, Options, Result, Table, at_least, at_most
from bench.measure.runs import Run, Runs, Work

FOLDER = Path(__file__).parents[2] / "examples" / "exercises"
ONE_LINE = "star_in_one_line"
_EPISODES = 100
# A whole job, beyond its compiling, and the line's hundred episodes; seconds on two cores.
_MOST_S, _ONE_LINE_S = 60.0, 40.0
# What is learnt does not depend on the load, so a busy machine may take its time for that.
_TIMEOUT_S = 3000.0
_QUICK: dict[str, Any] = {
    "num_arms": 3,
    "num_segments_per_arm": 1,
    "simulation_time": 2.0,
    "target_distance": 0.5,
}


def measure(options: Options) -> Result:
    """The one line with nothing compiled and again; then every other exercise, once."""
    runs = Runs("exercises", options)
    runs.make(works(options))
    return Result(
        name="exercises",
        title="A star in one line, and the notebook's exercises",
        command="./run bench exercises",
        quick=options.quick,
        machine=runs.where(),
        figures=[*_of_the_line(runs), *_of_all(runs.done)],
        rows=[_row(name, run) for name, run in runs.done.items()],
        table=_table(runs.done),
        notes=[*_NOTES, *runs.notes()],
        unfinished=runs.left,
    )


def works(options: Options) -> list[Work]:
    """The line first: it leaves what it compiles, the star's machine code too, for the others."""
    jobs = {path.stem: json.loads(path.read_text()) for path in sorted(FOLDER.glob("*.json"))}
    line = jobs.pop(ONE_LINE)
    cold = _work("cold", line, options, cache="line", cold=True)
    warm = _work("warm", line, options, cache="line", after=cold)
    others = () if options.quick else jobs.items()
    return [cold, warm, *(_work(name, job, options, cache="line", after=cold) for name, job in others)]


def _work(name: str, job: dict[str, Any], options: Options, **more: Any) -> Work:
    episodes = _EPISODES
    if options.quick:
        algorithm = {**job["algorithm"], "num_episodes": 4, "num_envs": 2, "num_eval_envs": 2}
        environment = {"id": job["environment"], "options": _QUICK}
        job, episodes = {**job, "environment": environment, "algorithm": algorithm, "video": None}, 4
    request = {"job": job, "episodes": episodes}
    return Work(name, "bench.ours.train_job", request, timeout_s=_TIMEOUT_S, about_s=100, **more)


def _of_the_line(runs: Runs) -> list[Figure]:
    figures = list[Figure]()
    for name, target in (("cold", None), ("warm", at_most(_ONE_LINE_S))):
        what = f"the line, {name}: the process's begin to the learnt table"
        if run := runs.done.get(name):
            figures.append(Figure(name=what, value=run["learnt_s"], unit="s", target=target))
        elif why := runs.failed.get(name):
            figures.append(Figure(name=what, value=None, unit="s", target=target, missing=why))
    return figures


def _of_all(done: dict[str, Run]) -> list[Figure]:
    """Targets reached; and the longest training, of the exercises."""
    exercises = {name: run for name, run in done.items() if name not in ("cold", "warm")}
    line = {"the line": done["warm"]} if "warm" in done else {}
    figures = [
        Figure(
            name=f"{name}: unseen targets reached",
            value=100 * run["reached"],
            unit="%",
            target=at_least(100 if name in line else 90),
        )
        for name, run in {**line, **exercises}.items()
    ]
    if exercises:
        longest = max(run["training_s"] for run in exercises.values())
        what = "the longest training of an exercise"
        figures.append(Figure(name=what, value=longest, unit="s", target=at_most(_MOST_S)))
    return figures


def _table(done: dict[str, Run]) -> Table | None:
    if not done:
        return None
    headings = [
        "Job",
        "Control steps",
        "Training, s",
        "Steps/s",
        "From the process's begin to the policy, s",
        "Targets reached, %",
        "after, s of simulated time",
        "Mean return, m",
    ]
    rows = [
        [
            "star_in_one_line, " + name if name in ("cold", "warm") else name,
            f"{run['steps']:,}",
            f"{run['training_s']:.1f}",
            f"{run['steps_per_s']:,.0f}",
            f"{run['learnt_s']:.1f}",
            f"{100 * run['reached']:.0f}",
            f"{run['arrived_s']:.1f}",
            f"{run['mean_return']:.2f}",
        ]
        for name, run in done.items()
    ]
    return Table(headings=headings, rows=rows)


def _row(name: str, run: Run) -> dict[str, str | int | float | bool | None]:
    kept = {key: value for key, value in run.items() if isinstance(value, str | int | float | bool | None)}
    return {"run": name, **kept, "phases": str(run["phases"])}


_NOTES = (
    "Each is a whole training process, as a worker starts it, on the engine that `auto` takes: imports, "
    "compiling, training, one evaluation, the policy's file. The line's first run begins with "
    "nothing compiled; its second finds all of that, and the others the star's machine code.",
    f"Targets reached: of {_EPISODES} episodes from another seed, without exploration; 3 m away in random "
    "directions, within the 20 s of an episode (`arms_amplitudes`: 40 s).",
)
