"""Figures of training runs: rates, returns over seeds, shares of the wall time, and their pictures."""

from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any

from bench.measure.result import Bars, Figure, Line, Panel, Target, at_least
from bench.measure.runs import Run
from bench.measure.statistics import Estimate, difference_in_errors, estimate

UNIT = "training steps/s"
Row = dict[str, str | int | float | bool | None]


def rate(training: Sequence[Sequence[float]]) -> float:
    """Steps per second over the second half of (steps, seconds so far), or since the last report but one.

    The first report's seconds include compilation. Raises ValueError if there is no other report.
    """
    if len(training) < 2:
        raise ValueError("One point has no second half: the run reported only once.")
    end_step, end_s = training[-1]
    half_step, half_s = next((point for point in training[:-1] if 2 * point[0] >= end_step), training[-2])
    return (end_step - half_step) / (end_s - half_s)


def last_return(run: Run) -> float:
    return run["rewards"][-1][1]


def returns(runs: Sequence[Run]) -> Estimate:
    """The returns of the last evaluation, over runs of different seeds."""
    return estimate([last_return(run) for run in runs])


def versus(name: str, ours: Sequence[Run], theirs: Sequence[Run]) -> list[Figure]:
    """The difference of our return and theirs in its standard errors; empty with one seed."""
    value = difference_in_errors(returns(ours), returns(theirs))
    if value is None:
        return []
    return [Figure(name=name, value=value, unit="standard errors of the difference", target=at_least(-1))]


def evaluations_share(run: Run) -> float:
    """Per cent of the wall time that evaluations took."""
    return 100 * run["evaluation_s"] / run["wall_s"]


def quotient(
    name: str, above: float | None, below: float | None, target: Target | None = None
) -> list[Figure]:
    """One number over another; empty if one of them was not measured."""
    if above is None or below is None:
        return []
    return [Figure(name=name, value=above / below, unit="×", target=target)]


def row(name: str, run: Run, **more: Any) -> Row:
    """A run as one line of the JSON."""
    return {
        "run": name,
        **more,
        "steps": run["training"][-1][0],
        "training_steps_per_second": rate(run["training"]) if len(run["training"]) > 1 else None,
        "wall_s": run["wall_s"],
        "evaluation_s": run.get("evaluation_s"),
        "process_s": run["process_s"],
        **{f"{phase}_s": seconds for phase, seconds in run.get("phases", {}).items()},
        "final_return": last_return(run) if run["rewards"] else None,
        "peak_bytes": run.get("peak_bytes"),
        "returns": ", ".join(f"{step}: {value:.0f}" for step, value in run["rewards"]),
        "training": ", ".join(f"{step}: {seconds:.2f} s" for step, seconds in run["training"]),
    }


def step_rows(done: Mapping[str, Run]) -> list[Row]:
    """What bench.ours.run_steps found, as lines of the JSON."""
    return [
        {
            "run": name,
            "engine": engine,
            "num_envs": int(num_envs),
            "control_steps_per_second": median(rates),
        }
        for name, run in done.items()
        for engine, by_num_envs in run["rates"].items()
        for num_envs, rates in by_num_envs.items()
    ]


def by_steps(runs: Mapping[str, Sequence[Run]], title: str = "Return at equal steps") -> Panel:
    """Every run's learning curve; runs by the label of their trainer."""
    lines = [Line(label=label, points=run["rewards"]) for label, of_one in runs.items() for run in of_one]
    return Panel(title=title, x="environment steps", y="return per episode", lines=lines)


def by_wall(runs: Mapping[str, Run], title: str) -> Panel:
    """Learning curves over the seconds since the trainer was called."""
    lines = [
        Line(
            label=label,
            points=[(s, value) for s, (_, value) in zip(run["evaluated_s"], run["rewards"], strict=True)],
        )
        for label, run in runs.items()
    ]
    return Panel(title=title, x="seconds", y="return per episode", lines=lines)


def wall_parts(runs: Mapping[str, Run]) -> Bars:
    """How each run spent its wall time; runs by their label. Brax compiles within epochs and evaluations."""
    steady = [run["training"][-1][0] / rate(run["training"]) for run in runs.values()]
    evaluating = [run["evaluation_s"] for run in runs.values()]
    rest = [run["wall_s"] - a - b for run, a, b in zip(runs.values(), steady, evaluating, strict=True)]
    return Bars(
        title="Where the wall goes",
        unit="s",
        groups=list(runs),
        series={
            "training at the steady rate": list(steady),
            "evaluations": list(evaluating),
            "the rest, mostly compiling": list(rest),
        },
        stacked=True,
    )
