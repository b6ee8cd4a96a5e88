"""PPO on a GPU, the rodent on a floor: our loop on Warp against Brax's, and Warp against MJX-JAX."""

from statistics import median
from typing import Any

from bench.measure import comparison, requests
from bench.measure.comparison import UNIT, rate
from bench.measure.requests import Settings
from bench.measure.result import Figure, Options, Result, Target, at_least
from bench.measure.runs import Runs, Work
from core.environments.info import Device

_NUM_ENVS = 2048
_EPOCHS = 4
_UPDATES = 24
_ENGINE = "warp"
_PHYSICS = "control steps/s"
# MJX-JAX needs over a second for these.
_MJX_STEPS = 2
_TIMEOUT_S = 1500.0


def measure(options: Options) -> Result:
    """Measure ours and its physics alone, Brax on the same engine, and MJX-JAX's physics alone."""
    device, body = requests.gpu("gpu_rodent", options), requests.body("rodent", options)
    updates = 8 if options.quick else _UPDATES
    # The engine for a GPU; an engine that compiles fast where the bench is only tried out.
    engine = _ENGINE if device == "gpu" else "native"
    given = _settings(device, body, options)
    whole = requests.whole_updates(device, body, given, updates)
    runs = Runs("gpu_rodent", options)
    ours = {**requests.ours(device, body, engine, whole), "physics_s": 0.1 if options.quick else 5.0}
    same = requests.brax(device, body, engine, whole, epochs=_EPOCHS, evaluate=False)
    mjx = {
        **requests.ours(device, body, "mjx", whole),
        "physics_s": 0.1 if options.quick else 5.0,
        "steps_per_call": _MJX_STEPS,
    }
    runs.make_together(
        [
            Work("ours", "bench.ours.run_engine", ours, _TIMEOUT_S, about_s=90, cache="ours", cold=True),
            Work("brax", "bench.peers.train_brax", same, _TIMEOUT_S, about_s=150, cache="brax", cold=True),
            Work("mjx", "bench.ours.run_physics", mjx, _TIMEOUT_S, about_s=150),
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
        rows=[comparison.row(name, run) for name, run in runs.done.items() if "training" in run],
        notes=[*_notes(given, updates), *runs.notes()],
        unfinished=runs.left,
    )


def _settings(device: Device, body: str, options: Options) -> Settings:
    wanted: dict[str, Any] = {} if options.quick else {"num_envs": _NUM_ENVS}
    return requests.settings(device, body, options, num_evals=0, reset_pool_size=0, **wanted)


def _figures(runs: Runs) -> list[Figure]:
    rates = {name: rate(run["training"]) for name, run in runs.done.items() if "training" in run}
    alone = {name: median(run["physics"]) for name, run in runs.done.items() if "physics" in run}
    ours, mjx = rates.get("ours"), alone.get("mjx")
    figures = [
        _measured("ours, on Warp", ours, UNIT, runs.failed.get("ours"), at_least(150_000)),
        _measured("Brax, on Warp", rates.get("brax"), UNIT, runs.failed.get("brax")),
        _measured("physics alone, Warp", alone.get("ours"), _PHYSICS, runs.failed.get("ours")),
        _measured("physics alone, MJX-JAX", mjx, _PHYSICS, runs.failed.get("mjx")),
    ]
    quotients = [
        *comparison.quotient("ours ÷ Brax, both on Warp", ours, rates.get("brax")),
        *comparison.quotient("physics alone ÷ our training", alone.get("ours"), ours),
        *comparison.quotient("physics alone, Warp ÷ MJX-JAX", alone.get("ours"), mjx, at_least(10)),
        *comparison.quotient("our training ÷ MJX-JAX's physics alone", ours, mjx, at_least(10)),
    ]
    if run := runs.done.get("ours"):
        lost = 100 * run["overflow"]
        quotients.append(Figure(name="steps in which contacts were lost, at most", value=lost, unit="%"))
    return [figure for figure in figures if figure] + quotients


def _measured(
    name: str, value: float | None, unit: str, why: str | None, target: Target | None = None
) -> Figure | None:
    """None if it was neither measured nor failed."""
    if value is None and why is None:
        return None
    return Figure(name=name, value=value, unit=unit, target=target, missing=why)


def _notes(given: Settings, updates: int) -> list[str]:
    return [
        f"{given.get('num_envs', _NUM_ENVS):,} environments under the rodent's tuned settings for a GPU, "
        f"{updates} updates without evaluations; the rate is of training alone, over the second half of the "
        "run. A training step is one control step of one environment. Brax has neither the bound on "
        "observations nor the random beginnings of episodes that these settings have; they cost "
        "next to no time.",
        "MJX-JAX: the same environments under random actions, without networks. Brax's trainer on MJX-JAX "
        "was not measured: it compiles its loop twice, and the second time had not ended after 17 minutes. "
        "It cannot be faster than this physics alone.",
    ]
