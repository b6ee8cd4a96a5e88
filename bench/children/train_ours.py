"""One training by this project's trainer, called directly.

Request: environment, options; settings (of the algorithm, which its `kind` names); engine (or `auto`); seed,
or several, which one program trains; device (`cpu` or `gpu`); cache, a folder for compiled programs; mark
(bench.train.Mark) or null: the run ends where an evaluation has it, and another from other starts, too.
"""

import time
from pathlib import Path
from typing import Any

from bench.child import answer


def work(request: dict[str, Any]) -> dict[str, Any]:
    """training: [[steps, seconds of training until then], …]; curve: [[steps, value of the mark's metric, or
    the return, seconds from the call], …]; reached_s: of them, at the mark, or null; reached_at: the hour of
    that; first_update_s and ended_s: from the call; engine."""
    from core.algorithms.events import Evaluated, Phase, TrainingProgress
    from core.algorithms.run import make_run
    from core.algorithms.seeds import make_seeds_run
    from core.environments import catalog
    from core.jobs.resolved import resolve_job
    from core.jobs.spec import TrainSpec
    from core.physics.choose import engine_builder

    mark, device = request["mark"], request["device"]
    body = {"id": request["environment"], "options": request["options"]}
    job = resolve_job(TrainSpec.model_validate({"environment": body, "algorithm": request["settings"]}))
    info, settings = job.info, job.settings_on(device)
    engine = engine_of(request["engine"], info, device, settings.num_parallel_envs)
    keep_compiled(request["cache"], engine)
    environment = catalog.make(info, job.options, engine_builder(engine))
    metric = mark["metric"] if mark else "eval/episode_reward"
    told: dict[str, Any] = {"training": [], "curve": [], "reached_s": None, "reached_at": None}
    told |= {"engine": engine, "first_update_s": None}
    began, confirming = time.perf_counter(), 0.0
    if isinstance(request["seed"], list):
        run = make_seeds_run(environment, settings, seeds=request["seed"], checkpoint_every_steps=None)
    else:
        run = make_run(environment, settings, seed=request["seed"], checkpoint_every_steps=None)
    for event in run.events():
        seconds = time.perf_counter() - began - confirming
        match event:
            case Phase(name="first_update"):
                told["first_update_s"] = seconds
            case TrainingProgress(step=step, metrics=metrics):
                told["training"].append((step, metrics["training/walltime"]))
            case Evaluated(step=step, metrics=metrics):
                reached_at = time.time()
                told["curve"].append((step, metrics.get(metric), seconds))
                if mark and metrics[metric] >= mark["least"]:
                    before = time.perf_counter()
                    again = run.evaluate(1_000)[metric]
                    confirming += time.perf_counter() - before
                    if again >= mark["least"]:
                        return {**told, "reached_s": seconds, "reached_at": reached_at}
            case _:
                pass
    return {**told, "ended_s": time.perf_counter() - began}


def keep_compiled(cache: str, engine: str) -> None:
    """Keep in this folder what JAX and the engine compile, as a worker does."""
    import jax

    from core.physics.choose import set_warp_cache
    from mujoco_compiled import keep_code

    jax.config.update("jax_compilation_cache_dir", cache)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    if engine == "warp":
        set_warp_cache(Path(cache, "warp"))
    if engine == "compiled":
        keep_code(Path(cache, "compiled"))


def engine_of(name: str, info: Any, device: Any, num_envs: int) -> Any:
    """The engine of this name, or the one that `auto` takes.

    Raises RuntimeError if that lacks its package here: `auto` would take another one, and be measured.
    """
    from core.physics.availability import choose, is_installed

    if name != "auto":
        return name
    rules = info.rules_on(device)
    wanted = next((rule.engine for rule in rules if rule.fits(num_envs, None)), None)
    if device == "gpu" and wanted is not None and not is_installed(wanted):
        raise RuntimeError(f"{wanted} is not installed: `uv sync --inexact --extra {wanted}` installs it.")
    return choose("auto", device, num_envs, rules, info.cannot_run).name


if __name__ == "__main__":
    answer(work)
