"""Whole PPO runs on a GPU: this project's loop against Brax's `ppo.train`, from a cold and a warm cache."""

import tempfile
from dataclasses import dataclass
from functools import partial
from typing import Any

from bench.child import run_child
from bench.machine import this_machine
from bench.result import Figure, Options, Result, at_least
from bench.statistics import alternate, spread
from bench.training import rate
from core.algorithms.ppo.spec import PPOSpec, resolve
from core.environments import catalog
from core.physics.availability import choose

_TIMEOUT_S = 560.0
_NUM_EVAL_ENVS = 128  # Brax's default
_UNIT = "training steps/s"
_SAME = "brax_same_engine"
_WHO = {"ours": "ours", "brax": "Brax", _SAME: "Brax on our engine"}


@dataclass(frozen=True)
class Run:
    """num_evals: of both trainers; Brax's first comes before the training."""

    environment: str
    num_timesteps: int
    num_evals: int


def compare(run: Run, options: Options) -> Result:
    """Each trainer in a process of its own: cold both, then warm both in the other order.

    Ours on the engine that `auto` takes, Brax on MJX-JAX as its own environments are; then Brax on ours.
    """
    machine = this_machine()
    with tempfile.TemporaryDirectory(prefix="gaitway-bench-") as ours, tempfile.TemporaryDirectory() as brax:
        request = _request(run, options)
        engine = choose("auto", "gpu", run.environment, _num_envs(run)).name
        train_brax = partial(run_child, "bench.train_brax", timeout_s=_TIMEOUT_S)
        runs = alternate(
            2,
            ours=partial(
                run_child,
                "bench.train_ours",
                {**request, "engine": engine, "cache": ours},
                timeout_s=_TIMEOUT_S,
            ),
            brax=partial(train_brax, {**request, "engine": "mjx", "cache": brax}),
        )
        if engine != "mjx":
            runs[_SAME] = [train_brax({**request, "engine": engine, "cache": None})]
    return Result(
        name=f"gpu_{run.environment}",
        title=f"PPO on a GPU, {run.environment}",
        command=f"./run bench gpu_{run.environment}",
        quick=options.quick,
        machine=machine,
        figures=_figures(runs),
        rows=_rows(runs),
        notes=_notes(request["settings"], engine),
    )


def _num_envs(run: Run) -> int:
    return resolve(PPOSpec(), catalog.find(run.environment), "gpu").num_envs


def _request(run: Run, options: Options) -> dict[str, Any]:
    settings: dict[str, Any] = {
        "num_timesteps": run.num_timesteps // (20 if options.quick else 1),
        "num_evals": run.num_evals,
        "num_eval_envs": _NUM_EVAL_ENVS,
        "reset_pool_size": 0,  # back to its own first state, as Brax's environments go
    }
    return {
        "environment": run.environment,
        "device": "gpu",
        "settings": settings,
        "seed": 0,
        "checkpoint_every_steps": None,
        "epochs": run.num_evals - 1,
        "evaluate": True,
    }


def _figures(runs: dict[str, list[dict[str, Any]]]) -> list[Figure]:
    walls = {name: [one["wall_s"] for one in of_one] for name, of_one in runs.items()}
    rates = {name: spread([rate(one["training"]) for one in of_one]) for name, of_one in runs.items()}
    figures = list[Figure]()
    for turn, (temperature, target) in enumerate((("cold", 3), ("warm", 4))):
        quotient = walls["brax"][turn] / walls["ours"][turn]
        figures += [
            Figure(name=f"ours, wall, {temperature} cache", value=walls["ours"][turn], unit="s"),
            Figure(name=f"Brax, wall, {temperature} cache", value=walls["brax"][turn], unit="s"),
            Figure(
                name=f"Brax's wall ÷ ours, {temperature} cache",
                value=quotient,
                unit="×",
                target=at_least(target),
            ),
        ]
    return [
        *figures,
        *(Figure.of(f"{_WHO[name]}, steady", rates[name], _UNIT) for name in runs),
        Figure(
            name="ours ÷ Brax, steady",
            value=rates["ours"].median / rates["brax"].median,
            unit="×",
            target=at_least(1.5),
        ),
        *(
            Figure.of(
                f"{_WHO[name]}, return at the end", spread([one["rewards"][-1][1] for one in runs[name]]), ""
            )
            for name in runs
        ),
        *(
            Figure(name=f"{_WHO[name]}, peak device memory of JAX", value=peak / 1e9, unit="GB")
            for name in runs
            if (peak := runs[name][0]["peak_bytes"])
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


def _notes(settings: dict[str, Any], engine: str) -> list[str]:
    return [
        f"Ours runs on the engine `{engine}`, which `auto` takes there, Brax on MJX-JAX; both train the same "
        f"environment with Brax's published settings for {settings['num_timesteps']:,} steps, with "
        f"{settings['num_evals']} evaluations of {_NUM_EVAL_ENVS} episodes. Brax runs with a shim for a JAX "
        "function that has been removed, over this project's environments, which carry less through MJX than "
        "Brax's own do.",
        "The wall is from the call to its return, with tracing, compiling and evaluating, without the import "
        "of JAX. The cold cache is an empty folder, also for Warp's kernels; the warm one is what the same "
        "trainer's cold run left.",
        "Steady: training alone over the second half of the run's reports. Warp's own buffers are not in "
        "JAX's memory.",
    ]
