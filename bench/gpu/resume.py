"""Whether a training on compiled physics gives the same bits again on a GPU, its rate, and its cost."""

from typing import Any

from bench.measure import requests
from bench.measure.result import Figure, Options, Result, Table, at_least
from bench.measure.runs import Run, Runs, Work
from bench.peers.published import PUBLISHED
from core.environments.info import Device

_UPDATES = 24
# Training steps per second to reach without deterministic operations.
_RATES = {"ant": 3.3e6, "humanoid": 1.5e6}
_KEPT, _USUAL = "deterministic", "as usual"


def measure(options: Options) -> Result:
    """Bodies under Brax's published settings: with XLA's deterministic operations, and without."""
    device = requests.gpu("gpu_resume", options)
    bodies = [requests.body("ant", options)] if options.quick else list(_RATES)
    runs = Runs("gpu_resume", options)
    runs.make(
        Work(_name(body, kind), "bench.ours.resume_ppo", _request(device, body, kind, options), about_s=60)
        for body in bodies
        for kind in (_KEPT, _USUAL)
    )
    return Result(
        name="gpu_resume",
        title="The same bits on a GPU",
        command="./run bench gpu_resume",
        quick=options.quick,
        machine=runs.where(),
        figures=[figure for body in bodies for figure in _figures(body, runs.done)],
        table=_table(runs.done),
        rows=[{"run": name, **run} for name, run in runs.done.items()],
        notes=[
            "PPO on compiled physics under Brax's published settings: one run, the same run again, and one "
            f"that goes on from the first one's checkpoint after half of {_UPDATES} updates. Checkpoints are "
            "compared byte by byte.",
            "Deterministic: XLA_FLAGS=--xla_gpu_deterministic_ops=true.",
            *runs.notes(),
        ],
        unfinished=runs.left,
    )


def _name(body: str, kind: str) -> str:
    return f"{body}, {kind}"


def _request(device: Device, body: str, kind: str, options: Options) -> dict[str, Any]:
    published = {} if options.quick else PUBLISHED[body]
    given = requests.settings(device, body, options, num_evals=0, **published)
    updates = 4 if options.quick else _UPDATES
    given = requests.whole_updates(device, body, given, updates)
    return {**requests.ours(device, body, "compiled", given), "deterministic": kind == _KEPT}


def _figures(body: str, done: dict[str, Run]) -> list[Figure]:
    kept, usual = done.get(_name(body, _KEPT)), done.get(_name(body, _USUAL))
    found = list[Figure]()
    for kind, what in (("twice", "a second run"), ("resumed", "a resumed run")):
        value = None if kept is None else float(kept[kind])
        name = f"{body}: {what} ends in the same bits, deterministic operations"
        found.append(Figure(name=name, value=value, unit="(1: yes)", target=at_least(1.0)))
    if usual is not None:
        least = _RATES.get(body)
        target = at_least(least) if least else None
        rate = usual["steps_per_s"]
        found.append(Figure(name=f"{body}: training", value=rate, unit="steps/s", target=target))
        if kept is not None and rate:
            ratio = kept["steps_per_s"] / rate
            found.append(Figure(name=f"{body}: steps/s, deterministic ÷ as usual", value=ratio, unit="×"))
    return found


def _table(done: dict[str, Run]) -> Table | None:
    rows = [
        [name, _said(run["twice"]), _said(run["resumed"]), f"{run['steps_per_s']:,.0f}"]
        for name, run in done.items()
    ]
    headings = ["operations", "same bits twice", "same bits resumed", "steps/s"]
    return Table(headings=headings, rows=rows) if rows else None


def _said(truth: bool) -> str:
    return "yes" if truth else "no"
