"""Whole PPO runs on a GPU: this project's loop against Brax's `ppo.train`, from a cold and a warm cache."""

import tempfile
from dataclasses import dataclass
from functools import partial
from typing import Any

from bench.child import run_child
from bench.machine import this_machine
from bench.result import Figure, Options, Result, at_least
from bench.statistics import alternate, ratios, spread
from bench.training import rate

_TIMEOUT_S = 560.0
_NUM_EVAL_ENVS = 128  # Brax's default
_UNIT = "training steps/s"


@dataclass(frozen=True)
class Run:
    """num_evals: of both trainers; Brax's first comes before the training."""

    environment: str
    num_timesteps: int
    num_evals: int


def compare(run: Run, options: Options) -> Result:
    """Each trainer in a process of its own: cold both, then warm both in the other order."""
    machine = this_machine()
    with tempfile.TemporaryDirectory(prefix="gaitway-bench-") as ours, tempfile.TemporaryDirectory() as brax:
        request = _request(run, options)
        runs = alternate(
            2,
            ours=partial(run_child, "bench.train_ours", {**request, "cache": ours}, timeout_s=_TIMEOUT_S),
            brax=partial(run_child, "bench.train_brax", {**request, "cache": brax}, timeout_s=_TIMEOUT_S),
        )
    return Result(
        name=f"gpu_{run.environment}",
        title=f"PPO on a GPU, {run.environment}",
        command=f"./run bench gpu_{run.environment}",
        quick=options.quick,
        machine=machine,
        figures=_figures(runs),
        rows=_rows(runs),
        notes=_notes(request["settings"]),
    )


def _request(run: Run, options: Options) -> dict[str, Any]:
    settings: dict[str, Any] = {
        "num_timesteps": run.num_timesteps // (20 if options.quick else 1),
        "num_evals": run.num_evals,
        "num_eval_envs": _NUM_EVAL_ENVS,
    }
    return {
        "environment": run.environment,
        "engine": "mjx",
        "device": "gpu",
        "settings": settings,
        "seed": 0,
        "checkpoint_every_steps": None,
        "epochs": run.num_evals - 1,
        "evaluate": True,
    }


def _figures(runs: dict[str, list[dict[str, Any]]]) -> list[Figure]:
    walls = {name: [one["wall_s"] for one in of_one] for name, of_one in runs.items()}
    rates = {name: [rate(one["training"]) for one in of_one] for name, of_one in runs.items()}
    figures = list[Figure]()
    for turn, (temperature, target) in enumerate((("cold", 3), ("warm", 4))):
        figures += [
            Figure(name=f"{who}, wall, {temperature} cache", value=walls[name][turn], unit="s")
            for name, who in (("ours", "ours"), ("brax", "Brax"))
        ]
        quotient = walls["brax"][turn] / walls["ours"][turn]
        figures.append(
            Figure(
                name=f"Brax's wall ÷ ours, {temperature} cache",
                value=quotient,
                unit="×",
                target=at_least(target),
            )
        )
    return [
        *figures,
        Figure.of("ours, steady", spread(rates["ours"]), _UNIT),
        Figure.of("Brax, steady", spread(rates["brax"]), _UNIT),
        Figure.of("ours ÷ Brax, steady", ratios(rates["ours"], rates["brax"]), "×", at_least(1.5)),
        Figure.of("ours, return at the end", spread([one["rewards"][-1][1] for one in runs["ours"]]), ""),
        Figure.of("Brax, return at the end", spread([one["rewards"][-1][1] for one in runs["brax"]]), ""),
        *(
            Figure(name=f"{who}, peak device memory", value=runs[name][0]["peak_bytes"] / 1e9, unit="GB")
            for name, who in (("ours", "ours"), ("brax", "Brax"))
            if runs[name][0]["peak_bytes"]
        ),
    ]


def _rows(runs: dict[str, list[dict[str, Any]]]) -> list[dict[str, Any]]:
    return [
        {
            "trainer": name,
            "cache": ("cold", "warm")[turn],
            "steps": one["training"][-1][0],
            "training_steps_per_second": rate(one["training"]),
            "wall_s": one["wall_s"],
            "process_s": one["process_s"],
            **{f"{phase}_s": seconds for phase, seconds in one.get("phases", {}).items()},
            "returns": ", ".join(f"{step}: {value:.0f}" for step, value in one["rewards"]),
            "training": ", ".join(f"{step}: {seconds:.2f} s" for step, seconds in one["training"]),
        }
        for name, of_one in runs.items()
        for turn, one in enumerate(of_one)
    ]


def _notes(settings: dict[str, Any]) -> list[str]:
    return [
        "Both train the same environment over MJX-JAX with Brax's published settings for "
        f"{settings['num_timesteps']:,} steps, with {settings['num_evals']} evaluations of {_NUM_EVAL_ENVS} "
        "episodes. Brax runs with a shim for a JAX function that has been removed.",
        "The wall is from the call to its return, with tracing, compiling and evaluating, without the import "
        "of JAX. The cold cache is an empty folder; the warm one is what the same trainer's cold run left.",
        "Steady: training alone over the second half of the run's reports.",
    ]
