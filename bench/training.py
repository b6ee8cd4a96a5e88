"""PPO's training steps per second on the CPU: this project's loop against Brax's `ppo.train`."""

from collections.abc import Sequence
from functools import partial
from typing import Any

from bench.child import run_child
from bench.machine import this_machine
from bench.result import Figure, Options, Result, at_least
from bench.statistics import alternate, ratios, spread

_UNIT = "training steps/s"
_UPDATE = 20_480  # environment steps in one update under the ant's tuned settings for a CPU
_EPOCHS = 4
_MJX = {"mjx": "Brax's fast settings", "mjx_equal": "equal solvers"}
_TIMEOUT_S = 1800.0

Run = dict[str, Any]


def measure(options: Options) -> Result:
    """Whole runs in processes of their own, alternating; then a few updates of Brax's over MJX-JAX."""
    machine = this_machine()
    rounds, updates = (1, 4) if options.quick else (2, 24)
    small = {"num_eval_envs": 2, "episode_length": 20} if options.quick else {}
    # Brax evaluates once before it begins; the number of evaluations is the same.
    settings = {"num_timesteps": updates * _UPDATE, "num_evals": _EPOCHS + 1, "reset_pool_size": 0, **small}
    request = {"environment": "ant", "engine": "native", "settings": settings, "seed": 0}
    ours = {**request, "cache": None, "checkpoint_every_steps": None}
    brax = {**request, "epochs": _EPOCHS, "evaluate": True}
    runs = alternate(
        rounds,
        ours=partial(run_child, "bench.train_ours", ours, timeout_s=_TIMEOUT_S),
        brax=partial(run_child, "bench.train_brax", brax, timeout_s=_TIMEOUT_S),
    )
    engines = ("mjx",) if options.quick else ("mjx", "mjx_equal")
    over_mjx = {
        engine: run_child("bench.train_brax", _mjx_request(engine, options), timeout_s=_TIMEOUT_S)
        for engine in engines
    }
    return Result(
        name="training",
        title="PPO on the CPU, ant",
        command="./run bench training",
        quick=options.quick,
        machine=machine,
        figures=_figures(runs, over_mjx),
        rows=_rows(**runs, **{f"brax over {engine}": [run] for engine, run in over_mjx.items()}),
        notes=_notes(settings["num_timesteps"], over_mjx),
    )


def _notes(num_timesteps: int, over_mjx: dict[str, Run]) -> list[str]:
    sizes = "; ".join(
        f"{_MJX[engine]}: {run['training'][-1][0]:,} steps in {run['training'][-1][1]:.0f} s"
        for engine, run in over_mjx.items()
    )
    return [
        "Both trainers run the same environment on the same engine with the same hyperparameters (the ant's "
        f"tuned ones for a CPU): {num_timesteps:,} steps, {_EPOCHS + 1} evaluations of 16 episodes. Brax "
        "runs with a shim for a JAX function that has been removed.",
        "The rate is of training alone, over the second half of the run: compilation and evaluations are not "
        "in it. The wall is from the call to its return, with everything, and nothing was compiled before.",
        "Brax steps each evaluation to the full episode length; ours ends with its last episode.",
        "Brax over MJX-JAX is one short run for each solver setting, with 256 ants and no evaluation; its "
        f"rate is of the second half, too, and scaled up, not trained to the end ({sizes}, compilation "
        "included). An update there is an eighth of the tuned one, with as many passes over its batch. Ours "
        "is taken from the runs over `native` above.",
    ]


def rate(training: Sequence[tuple[int, float]]) -> float:
    """Steps per second over the second half of (steps, seconds so far); compilation is in the first."""
    end_step, end_s = training[-1]
    half_step, half_s = next(point for point in training if 2 * point[0] >= end_step)
    if half_step == end_step:
        raise ValueError("One point has no second half: the run reported only once.")
    return (end_step - half_step) / (end_s - half_s)


def _mjx_request(engine: str, options: Options) -> dict[str, Any]:
    """The smallest run that has epochs after compilation."""
    num_envs, updates_per_epoch = (8, 1) if options.quick else (256, 2)
    steps_per_update = num_envs * 10
    settings = {
        "num_envs": num_envs,
        "batch_size": num_envs,
        "num_minibatches": 1,
        "num_timesteps": _EPOCHS * updates_per_epoch * steps_per_update,
    }
    return {
        "environment": "ant",
        "engine": engine,
        "settings": settings,
        "seed": 0,
        "epochs": _EPOCHS,
        "evaluate": False,
    }


def _figures(runs: dict[str, list[Run]], over_mjx: dict[str, Run]) -> list[Figure]:
    ours, brax = ([rate(run["training"]) for run in runs[name]] for name in ("ours", "brax"))
    walls = {name: [run["wall_s"] for run in runs[name]] for name in runs}
    returns = {name: spread([run["rewards"][-1][1] for run in runs[name]]) for name in runs}
    figures = [
        Figure.of("ours", spread(ours), _UNIT),
        Figure.of("Brax, same engine", spread(brax), _UNIT),
        Figure.of("ours ÷ Brax, same engine", ratios(ours, brax), "×", at_least(1.5)),
        Figure.of("ours, wall of the whole run", spread(walls["ours"]), "s"),
        Figure.of("Brax, wall of the whole run", spread(walls["brax"]), "s"),
        Figure.of("Brax's wall ÷ ours", ratios(walls["brax"], walls["ours"]), "×"),
        Figure.of("ours, return at the end", returns["ours"], ""),
        Figure.of("Brax, return at the end", returns["brax"], ""),
    ]
    for engine, run in over_mjx.items():
        peer = rate(run["training"])
        figures += [
            Figure(name=f"Brax over MJX-JAX, {_MJX[engine]}", value=peer, unit=_UNIT),
            Figure.of(
                f"ours ÷ Brax over MJX-JAX, {_MJX[engine]}",
                spread([value / peer for value in ours]),
                "×",
                at_least(50),
            ),
        ]
    return figures


def _rows(**runs: list[Run]) -> list[dict[str, Any]]:
    return [
        {
            "trainer": name,
            "round": turn,
            "steps": run["training"][-1][0],
            "training_steps_per_second": rate(run["training"]),
            "wall_s": run["wall_s"],
            "process_s": run["process_s"],
            "compile_s": run.get("phases", {}).get("compile"),
            "trace_s": run.get("phases", {}).get("trace"),
            "final_return": run["rewards"][-1][1] if run["rewards"] else None,
        }
        for name, of_one in runs.items()
        for turn, run in enumerate(of_one)
    ]
