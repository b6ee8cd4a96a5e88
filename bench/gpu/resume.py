"""Whether a training on compiled physics gives the same bits again on a GPU, and what that costs."""

from typing import Any

from bench.measure import requests
from bench.measure.result import Figure, Options, Result, Table, at_least
from bench.measure.runs import Run, Runs, Work
from core.environments.info import Device

_UPDATES = 24
_KINDS = {"deterministic": True, "as usual": False}


def measure(options: Options) -> Result:
    """The ant, under the tuned settings: with XLA's deterministic operations, and without."""
    device = requests.gpu("gpu_resume", options)
    body = requests.body("ant", options)
    runs = Runs("gpu_resume", options)
    runs.make(
        Work(name, "bench.ours.resume_ppo", _request(device, body, is_kept, options), about_s=60)
        for name, is_kept in _KINDS.items()
    )
    return Result(
        name="gpu_resume",
        title="The same bits on a GPU",
        command="./run bench gpu_resume",
        quick=options.quick,
        machine=runs.where(),
        figures=[*_figures(body, runs)],
        table=_table(runs.done),
        rows=[{"run": name, **run} for name, run in runs.done.items()],
        notes=[
            "PPO on compiled physics: one run, the same run again, and one that goes on from the first one's "
            f"checkpoint after half of {_UPDATES} updates. Checkpoints are compared byte by byte.",
            "Deterministic: XLA_FLAGS=--xla_gpu_deterministic_ops=true.",
            *runs.notes(),
        ],
        unfinished=runs.left,
    )


def _request(device: Device, body: str, is_kept: bool, options: Options) -> dict[str, Any]:
    given = requests.settings(device, body, options, num_evals=0)
    updates = 4 if options.quick else _UPDATES
    given = requests.whole_updates(device, body, given, updates)
    return {**requests.ours(device, body, "compiled", given), "deterministic": is_kept}


def _figures(body: str, runs: Runs) -> list[Figure]:
    found = list[Figure]()
    for kind, what in (("twice", "a second run"), ("resumed", "a resumed run")):
        run = runs.done.get("deterministic")
        value = None if run is None else float(run[kind])
        name = f"{body}: {what} ends in the same bits, deterministic operations"
        found.append(Figure(name=name, value=value, unit="(1: yes)", target=at_least(1.0)))
    rates = [run["steps_per_s"] for name in _KINDS if (run := runs.done.get(name))]
    if len(rates) == len(_KINDS):
        ratio = rates[0] / rates[1] if rates[1] else None
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
