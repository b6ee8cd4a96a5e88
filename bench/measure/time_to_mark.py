"""A body's way to a mark, and the figures of the runs on it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median

from bench.measure.comparison import Row
from bench.measure.marks import Mark
from bench.measure.result import Figure, Line, Panel, Picture, Table, at_least, at_most
from bench.measure.runs import Run, Runs
from bench.measure.statistics import spread

# How many times as long as the median seed the worst may take.
_WORST = 1.5


@dataclass(frozen=True)
class Gate:
    """One body's way to its mark.

    every_steps: training steps from one evaluation to the next; peer_every_steps: Brax's, if others, as its
    evaluations take longer. most_steps, peer_most_steps: of the whole budgets. algorithm: of ours; Brax's is
    PPO. warm_s, cold_s: seconds from the call in which it is to be there; start_s: from the process's start,
    warm, with each seed; video_s: from the submission to a video, warm; warm_times, cold_times: how many
    times as fast as Brax. job_steps: of the job that is submitted. peer_engine: of Brax's trainer; num_peers:
    its seeds, as they may take long; peer_most_s: seconds from the call after which its run is cut off.
    """

    body: str
    mark: Mark
    every_steps: int
    most_steps: int
    peer_engine: str
    algorithm: str = "ppo"
    job_steps: int | None = None
    warm_s: float | None = None
    cold_s: float | None = None
    start_s: float | None = None
    video_s: float | None = None
    warm_times: float | None = None
    cold_times: float | None = None
    num_peers: int | None = None
    peer_every_steps: int | None = None
    peer_most_steps: int | None = None
    peer_most_s: float | None = None


def figures(gate: Gate, runs: Runs) -> list[Figure]:
    """Seconds from the call to the mark; a run that did not come there has none, and misses."""
    ours, brax = (_warm(gate, who, runs.done) for who in ("ours", "brax"))
    ours_cold, brax_cold = (_cold(gate, who, runs.done) for who in ("ours", "brax"))
    found = [
        _seconds(f"{gate.body}, warm, median of the seeds", ours, gate.warm_s),
        *_worst(gate, ours),
        _seconds(f"{gate.body}, cold", ours_cold, gate.cold_s),
        _seconds(f"{gate.body}, Brax, warm", brax, None),
        _seconds(f"{gate.body}, Brax, cold", brax_cold, None),
        _times(f"{gate.body}, warm: Brax ÷ ours", brax, ours, gate.warm_times),
        _times(f"{gate.body}, cold: Brax ÷ ours", brax_cold, ours_cold, gate.cold_times),
    ]
    if ours and all(run["reached_s"] is not None for run in ours):
        from_start = [run["reached_at"] - run["began_at"] for run in ours]
        in_time = at_most(gate.start_s) if gate.start_s else None
        worst = f"{gate.body}, warm, from the process's start, worst seed"
        found.append(Figure(name=worst, value=max(from_start), unit="s", target=in_time))
        steps = [float(run["curve"][-1][0]) for run in ours]
        found.append(Figure.of(f"{gate.body}, steps until then", spread(steps), "steps"))
    return [*found, *_of_the_job(gate, runs)]


def _of_the_job(gate: Gate, runs: Runs) -> list[Figure]:
    """From the submission, through the whole service."""
    if gate.job_steps is None:
        return []
    name = f"{gate.body}-job"
    job = runs.done.get(name)
    missing = "it did not come" if job else runs.failed.get(name, "not run")
    return [
        Figure(
            name=f"{gate.body}, from the submission to the {what}, {which}",
            value=job[which][what] if job else None,
            unit="s",
            target=at_most(gate.video_s) if gate.video_s and (which, what) == ("warm", "video") else None,
            missing=None if job and job[which][what] is not None else missing,
        )
        for which in ("cold", "warm")
        for what in ("mark", "video")
    ]


def _cold(gate: Gate, who: str, done: Mapping[str, Run]) -> list[Run]:
    run = done.get(f"{gate.body}-{who}-cold")
    return [] if run is None else [run]


def _warm(gate: Gate, who: str, done: Mapping[str, Run]) -> list[Run]:
    names = (name for name in done if name.startswith(f"{gate.body}-{who}-") and not name.endswith("-cold"))
    return [done[name] for name in sorted(names)]


def _seconds(name: str, runs: Sequence[Run], most: float | None) -> Figure:
    target = at_most(most) if most else None
    reached = [run["reached_s"] for run in runs if run["reached_s"] is not None]
    if not runs or len(reached) < len(runs):
        why = f"{len(runs) - len(reached)} of {len(runs)} runs did not reach the mark" if runs else "not run"
        return Figure(name=name, value=None, unit="s", target=target, missing=why)
    return Figure.of(name, spread(reached), "s", target)


def _worst(gate: Gate, runs: Sequence[Run]) -> list[Figure]:
    reached = [run["reached_s"] for run in runs if run["reached_s"] is not None]
    if len(reached) < max(2, len(runs)):
        return []
    ratio = max(reached) / median(reached)
    return [
        Figure(
            name=f"{gate.body}, the worst seed ÷ the median", value=ratio, unit="×", target=at_most(_WORST)
        )
    ]


def _times(name: str, theirs: Sequence[Run], ours: Sequence[Run], least: float | None) -> Figure:
    """Where Brax did not reach the mark, it is counted with the time that it was given."""
    target = at_least(least) if least else None
    if any(run["reached_s"] is None for run in theirs):
        name += ", at least"
    if not theirs or not ours:
        return Figure(name=name, value=None, unit="×", target=target, missing="not run")
    if any(run["reached_s"] is None for run in ours):
        return Figure(name=name, value=None, unit="×", target=target, missing="not reached")
    own = median(run["reached_s"] for run in ours)
    peers = median(run["reached_s"] or run["curve"][-1][2] for run in theirs)
    return Figure(name=name, value=peers / own, unit="×", target=target)


def rows(done: Mapping[str, Run]) -> list[Row]:
    """Every evaluation of every run, for the JSON."""
    return [
        {"run": name, "steps": steps, "value": value, "seconds": seconds, "reached_s": run["reached_s"]}
        for name, run in done.items()
        for steps, value, seconds in run.get("curve", ())
    ]


def table(gates: Sequence[Gate], done: Mapping[str, Run]) -> Table | None:
    """Each run: where it was at its end, and what its seconds went into."""
    rows = [
        [
            name,
            f"{run['curve'][-1][0]:,}",
            f"{run['curve'][-1][1]:,.2f} {gate.mark.unit}".strip(),
            "not reached" if run["reached_s"] is None else f"{run['reached_s']:.1f}",
            *(f"{run.get(part, 0.0):.1f}" if part in run else "" for part in ("training_s", "evaluation_s")),
        ]
        for gate in gates
        for name, run in done.items()
        if name.startswith(f"{gate.body}-") and run.get("curve")
    ]
    headings = [
        "run",
        "steps",
        "its last evaluation",
        "seconds to the mark",
        "of it training",
        "evaluating",
    ]
    return Table(headings=headings, rows=rows) if rows else None


def picture(gate: Gate, bench: str, done: Mapping[str, Run]) -> Picture | None:
    """The mark's metric against seconds from the call, all warm runs."""
    lines = [
        Line(label=label, points=[(seconds, value) for _, value, seconds in run["curve"]])
        for who, label in (("ours", "ours"), ("brax", "Brax"))
        for run in _warm(gate, who, done)
        if run["curve"]
    ]
    if not lines:
        return None
    metric = "speed, m/s" if gate.mark.unit else "return"
    title = f"{gate.body}, to {gate.mark.least:g}"
    return Picture(
        name=f"{bench}_{gate.body}",
        caption=f"The {gate.body}'s {metric} against time, each seed a curve",
        panels=[Panel(title=title, x="seconds from the call", y=metric, lines=lines)],
    )
