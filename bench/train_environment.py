"""PPO on one environment, its tuned values changed by the request.

For a whole job with files use `gaitway run`; `bench.ours.train_ppo` is a child of the benches.

`python -m bench.train_environment FOLDER` reads FOLDER/request.json, for example
`{"environment": "ant", "device": "cpu"}`, and writes FOLDER/answer.json. In the request, `settings` changes
hyperparameters, `options` the environment, `seed` the seed. On a GPU, leave JAX_PLATFORMS unset.
"""

import time
from typing import Any, NamedTuple

from bench.measure.child import answer


class Begun(NamedTuple):
    """A run that has not trained yet (`core.algorithms.run.Run`), its environment, and its engine's name."""

    run: Any
    environment: Any
    engine: str


def begin(request: dict[str, Any]) -> Begun:
    """Request: environment, device (`cpu`, `gpu`), and changes to the tuned settings."""
    from core.algorithms.catalog import resolve
    from core.algorithms.ppo.spec import PPOSpec
    from core.algorithms.run import make_run
    from core.environments import catalog
    from core.physics.choose import choose, engine_builder

    info = catalog.find(request["environment"])
    options = catalog.parse_options(info, request.get("options", {}))
    info = info.under(options)
    device = request["device"]
    settings = resolve(PPOSpec(**request.get("settings", {})), info, device)
    choice = choose("auto", device, settings.num_envs, info.rules_on(device), info.cannot_run)
    environment = catalog.make(info, options, engine_builder(choice.name))
    run = make_run(environment, settings, seed=request.get("seed", 0), checkpoint_every_steps=None)
    return Begun(run, environment, choice.name)


def train(request: dict[str, Any]) -> dict[str, Any]:
    """Trains, and returns the curve, the phases and the steps per second. Takes the request of `begin`."""
    import jax

    from core.algorithms.events import Evaluated, Phase, Progress

    began = time.perf_counter()
    run, _, engine = begin(request)
    curve: list[dict[str, float]] = []
    rates: list[float] = []
    phases: dict[str, float] = {}
    for event in run.events():
        match event:
            case Phase(name=name, seconds=seconds):
                phases[name] = seconds
            case Progress(metrics=metrics):
                rates.append(metrics["training/sps"])
            case Evaluated(step=step, metrics=metrics):
                wall_s = time.perf_counter() - began
                curve.append({"step": step, "wall_s": wall_s, **_kept(metrics)})
            case _:
                pass
    return {
        "environment": request["environment"],
        "device": jax.devices()[0].device_kind,
        "engine": engine,
        "steps": run.step,
        "wall_s": time.perf_counter() - began,
        "steps_per_second": sorted(rates)[len(rates) // 2],
        "phases": phases,
        "curve": curve,
    }


def _kept(metrics: Any) -> dict[str, float]:
    names = ("eval/episode_reward", "eval/avg_episode_length", "eval/forward_speed")
    return {name.removeprefix("eval/"): metrics[name] for name in names if name in metrics}


if __name__ == "__main__":
    answer(train)
