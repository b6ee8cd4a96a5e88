"""What `bench.ours.run_steps` found of bodies under `compiled` and `native`: quotients and a table."""

from collections.abc import Mapping
from statistics import median

from bench.measure.result import Table
from bench.measure.runs import Run

ENGINES = ("compiled", "native")


def quotients(run: Run, num_envs: str) -> list[float]:
    """`compiled` over `native`, round by round."""
    ours, theirs = (run["rates"][engine][num_envs] for engine in ENGINES)
    return [one / other for one, other in zip(ours, theirs, strict=True)]


def steps_table(done: Mapping[str, Run], *, with_start: bool = False) -> Table | None:
    """A row for each body and number of environments. with_start: also the seconds to the first step."""
    if not done:
        return None
    rows = list[list[str]]()
    for body, run in done.items():
        ready = [f"{run['ready_s'][engine]:.1f}" for engine in ENGINES] if with_start else []
        for num in sorted(run["rates"]["native"], key=int):
            steps = [f"{median(run['rates'][engine][num]):,.0f}" for engine in ENGINES]
            rows.append([body, f"{int(num):,}", *steps, f"{median(quotients(run, num)):.1f}", *ready])
    headings = ["body", "environments", *(f"`{engine}`, control steps/s" for engine in ENGINES), "ratio"]
    if with_start:
        headings += [f"`{engine}`, s to its first step" for engine in ENGINES]
    return Table(headings=headings, rows=rows)
