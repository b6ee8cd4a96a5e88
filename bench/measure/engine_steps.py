"""What `bench.ours.run_steps` found of bodies under `compiled` and another engine: quotients and a table."""

from collections.abc import Mapping
from statistics import median

from bench.measure.result import Table
from bench.measure.runs import Run

ENGINES = ("compiled", "native")
ON_A_GPU = ("compiled", "warp")


def quotients(run: Run, num_envs: str) -> list[float]:
    """The first engine's rates over the second's, round by round."""
    ours, theirs = (of_engine[num_envs] for of_engine in run["rates"].values())
    return [one / other for one, other in zip(ours, theirs, strict=True)]


def steps_table(done: Mapping[str, Run], *, with_start: bool = False) -> Table | None:
    """A row for each body and number of environments. with_start: also the seconds to the first step."""
    if not done:
        return None
    engines = list(next(iter(done.values()))["rates"])
    rows = list[list[str]]()
    for body, run in done.items():
        ready = [f"{run['ready_s'][engine]:.1f}" for engine in engines] if with_start else []
        for num in sorted(run["rates"][engines[0]], key=int):
            steps = [f"{median(run['rates'][engine][num]):,.0f}" for engine in engines]
            rows.append([body, f"{int(num):,}", *steps, f"{median(quotients(run, num)):.1f}", *ready])
    headings = ["body", "environments", *(f"`{engine}`, control steps/s" for engine in engines), "ratio"]
    if with_start:
        headings += [f"`{engine}`, s to its first step" for engine in engines]
    return Table(headings=headings, rows=rows)
