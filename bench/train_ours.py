"""One run of this project's PPO trainer, called directly: `python -m bench.train_ours ANSWER REQUEST`.

Request: environment, engine, settings (hyperparameters), seed; device (`cpu`, which it is without one, or
`gpu`), devices (how many, 1 without); cache (a folder for compiled programs, or null);
checkpoint_every_steps (or null).
"""

import time
from pathlib import Path
from typing import Any

from bench.child import answer


def work(request: dict[str, Any]) -> dict[str, Any]:
    """training: [[steps, seconds of training until then], …]; wall_s: from the call to its return;
    first_update_at, evaluated_at: the hour of the first update's end and of the last evaluation's;
    peak_bytes: the most device memory in use, where the device counts it."""
    import jax

    from bench.device_memory import peak_bytes
    from core.algorithms.ppo.spec import PPOSpec, resolve
    from core.algorithms.ppo.trainer import PPOTrainer
    from core.algorithms.trainer import CheckpointReady, Evaluated, Phase, Progress
    from core.environments import catalog
    from core.physics.choose import engine_builder
    from core.physics.kernels import keep_kernels

    if request["cache"]:
        jax.config.update("jax_compilation_cache_dir", request["cache"])
        if request["engine"] == "warp":
            keep_kernels(Path(request["cache"], "warp"))
    info = catalog.find(request["environment"])
    build = engine_builder(request["engine"])
    environment = catalog.make(info, catalog.parse_options(info, {}), build)
    settings = resolve(PPOSpec.model_validate(request["settings"]), info, request.get("device", "cpu"))
    began = time.perf_counter()
    trainer = PPOTrainer(
        environment,
        settings,
        seed=request["seed"],
        checkpoint_every_steps=request["checkpoint_every_steps"],
        devices=request.get("devices", 1),
    )
    training, phases, rewards = list[tuple[int, float]](), dict[str, float](), list[tuple[int, float]]()
    first_update_at = evaluated_at = 0.0
    for event in trainer.events():
        match event:
            case Phase(name=name, seconds=seconds):
                phases[name] = seconds
                first_update_at = time.time() if name == "first_update" else first_update_at
            case Progress(step=step, metrics=metrics):
                training.append((step, metrics["training/walltime"]))
            case Evaluated(step=step, metrics=metrics):
                evaluated_at = time.time()
                rewards.append((step, metrics["eval/episode_reward"]))
            case CheckpointReady() if request["checkpoint_every_steps"]:
                Path(request["cache"], f"checkpoint-{trainer.step}").write_bytes(trainer.checkpoint())
            case CheckpointReady():
                pass
    return {
        "training": training,
        "rewards": rewards,
        "phases": phases,
        "wall_s": time.perf_counter() - began,
        "first_update_at": first_update_at,
        "evaluated_at": evaluated_at,
        "peak_bytes": peak_bytes(),
    }


if __name__ == "__main__":
    answer(work)
