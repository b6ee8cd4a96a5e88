"""One run of this project's PPO trainer, called directly: `python -m bench.train_ours ANSWER REQUEST`.

Request: environment, engine, settings (hyperparameters), seed; device (`cpu`, which it is without one, or
`gpu`), devices (how many, 1 without); cache (a folder for compiled programs, or null);
checkpoint_every_steps (or null); most_training_s (stop after so many seconds of training, and three
updates).
"""

import time
from pathlib import Path
from typing import Any

from bench.child import answer


def work(request: dict[str, Any]) -> dict[str, Any]:
    """training: [[steps, seconds of training until then], …]; rewards: [[steps, return], …], and
    evaluated_s: for each of them the seconds from the call; wall_s: from the call to its return;
    evaluation_s: of it, evaluating; first_update_s: from the call to the end of the first update;
    first_update_at, evaluated_at: the hour of that and of the last evaluation's end; overflow: the largest
    share of steps in which the engine lost contacts; peak_bytes: the most device memory in use, where the
    device counts it."""
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
    evaluated_s = list[float]()
    first_update_at = evaluated_at = first_update_s = evaluation_s = overflow = 0.0
    for event in trainer.events():
        match event:
            case Phase(name=name, seconds=seconds):
                phases[name] = seconds
                if name == "first_update":
                    first_update_at, first_update_s = time.time(), time.perf_counter() - began
            case Progress(step=step, metrics=metrics):
                training.append((step, metrics["training/walltime"]))
                overflow = max(overflow, metrics.get("training/physics_overflow", 0.0))
                if _long_enough(training, request.get("most_training_s")):
                    break
            case Evaluated(step=step, metrics=metrics):
                evaluated_at = time.time()
                evaluated_s.append(time.perf_counter() - began)
                rewards.append((step, metrics["eval/episode_reward"]))
                evaluation_s += metrics["eval/epoch_eval_time"]
            case CheckpointReady() if request["checkpoint_every_steps"]:
                Path(request["cache"], f"checkpoint-{trainer.step}").write_bytes(trainer.checkpoint())
            case CheckpointReady():
                pass
    return {
        "training": training,
        "rewards": rewards,
        "evaluated_s": evaluated_s,
        "phases": phases,
        "wall_s": time.perf_counter() - began,
        "evaluation_s": evaluation_s,
        "first_update_s": first_update_s,
        "first_update_at": first_update_at,
        "evaluated_at": evaluated_at,
        "overflow": overflow,
        "peak_bytes": peak_bytes(),
    }


def _long_enough(training: list[tuple[int, float]], most_s: float | None) -> bool:
    """Whether the training since the first update took as long as it may."""
    return most_s is not None and len(training) > 3 and training[-1][1] - training[0][1] > most_s


if __name__ == "__main__":
    answer(work)
