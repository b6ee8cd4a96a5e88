"""PPO on a GPU, the rodent on a floor: our loop on Warp against Brax's on Warp and on MJX-JAX."""

from statistics import median
from typing import Any

from bench import comparison, requests
from bench.comparison import UNIT, rate
from bench.requests import Settings
from bench.result import Figure, Options, Result, at_least
from bench.runs import Run, Runs, Work
from core.environments.info import Device

_WORLDS = 2048
_EPOCHS = 4
_UPDATES = 24
_ENGINE = "warp"
_TIMEOUT_S = 1500.0


def measure(options: Options) -> Result:
    """Ours with its physics alone, then Brax on the same engine, then, with a time limit, on MJX-JAX."""
    device, body = requests.gpu("gpu_rodent", options), requests.body("rodent", options)
    updates = 8 if options.quick else _UPDATES
    # The engine for a GPU; where the bench is only looked at, one that compiles fast.
    engine = _ENGINE if device == "gpu" else "native"
    given = _settings(device, body, options)
    whole = requests.whole_updates(device, body, given, updates)
    runs = Runs("gpu_rodent", options)
    ours = {**requests.ours(device, body, engine, whole), "physics_s": 0.1 if options.quick else 5.0}
    same = requests.brax(device, body, engine, whole, epochs=_EPOCHS, evaluate=False)
    small = _small(device, body, given)
    mjx = requests.brax(device, body, "mjx", small, epochs=_EPOCHS, evaluate=False)
    runs.make_together(
        [
            Work("ours", "bench.run_engine", ours, about_s=90, cache="ours", cold=True),
            Work("brax", "bench.train_brax", same, about_s=150, cache="brax", cold=True),
            Work("brax-mjx", "bench.train_brax", mjx, timeout_s=_TIMEOUT_S, about_s=300),
        ],
        at_once=3,
        in_turns=True,
    )
    return Result(
        name="gpu_rodent",
        title="PPO on a GPU, rodent on a floor",
        command="./run bench gpu_rodent",
        quick=options.quick,
        machine=runs.where(),
        figures=_figures(runs),
        rows=[comparison.row(name, run, finite=run.get("finite")) for name, run in runs.done.items()],
        notes=[*_notes(given, small, updates), *_mjx_notes(runs.done.get("brax-mjx")), *runs.notes()],
        unfinished=runs.left,
    )


def _settings(device: Device, body: str, options: Options) -> Settings:
    wanted: dict[str, Any] = {} if options.quick else {"num_envs": _WORLDS}
    return requests.settings(device, body, options, num_evals=0, reset_pool_size=0, **wanted)


def _small(device: Device, body: str, given: Settings) -> Settings:
    """The smallest update of as many worlds: MJX-JAX would need hours for whole ones."""
    num_envs = requests.resolved(device, body, given).num_envs
    least = {**given, "num_minibatches": 1, "batch_size": num_envs, "unroll_length": 5}
    return requests.whole_updates(device, body, least, _EPOCHS)


def _figures(runs: Runs) -> list[Figure]:
    rates = {name: rate(run["training"]) for name, run in runs.done.items()}
    ours, brax, mjx = (rates.get(name) for name in ("ours", "brax", "brax-mjx"))
    names = {"ours": "ours, on Warp", "brax": "Brax, on Warp", "brax-mjx": "Brax, on MJX-JAX"}
    targets = {"ours": at_least(150_000)}
    figures = [
        Figure(
            name=label,
            value=rates.get(name),
            unit=UNIT,
            target=targets.get(name),
            missing=runs.failed.get(name),
        )
        for name, label in names.items()
        if name in rates or name in runs.failed
    ]
    figures += comparison.quotient("ours ÷ Brax, both on Warp", ours, brax)
    figures += comparison.quotient("ours on Warp ÷ Brax on MJX-JAX", ours, mjx, at_least(10))
    if run := runs.done.get("ours"):
        alone = median(run["physics"])
        figures += [
            Figure(name="physics alone, Warp", value=alone, unit="control steps/s"),
            *comparison.quotient("physics alone ÷ our training", alone, ours),
            Figure(name="steps in which contacts were lost, at most", value=100 * run["overflow"], unit="%"),
        ]
    return figures


def _notes(given: Settings, small: Settings, updates: int) -> list[str]:
    return [
        f"{given.get('num_envs', _WORLDS):,} worlds under the rodent's tuned settings for a GPU, {updates} "
        "updates without evaluations; the rate is of training alone, over the second half of the run. A "
        "training step is one control step of one world.",
        f"Brax over MJX-JAX takes {_EPOCHS} updates of {small['num_timesteps'] // _EPOCHS:,} steps in one "
        "minibatch, with as many passes over them; its rate is scaled up, not trained to the end.",
        "The three are compiled side by side and timed one after the other.",
    ]


def _mjx_notes(run: Run | None) -> list[str]:
    if run is None or run["finite"]:
        return []
    return ["What Brax over MJX-JAX computed was not finite: its rate is that of a run that learns nothing."]
