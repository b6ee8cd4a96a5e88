"""One run of this project's PPO trainer, called directly: `python -m bench.ours.train_ppo FOLDER`.

Request: environment, engine, settings (hyperparameters), seed; device (`cpu`, the default, or `gpu`), devices
(how many; default 1); cache (a folder for compiled programs, or null); checkpoint_every_steps (or null);
most_training_s (stop after this many seconds of training and three updates); epoch_s (seconds between
reports; default 1).
"""

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bench.measure.cache import keep_compiled
from bench.measure.child import answer


def work(request: dict[str, Any]) -> dict[str, Any]:
    """training: [[steps, seconds of training until then], …]; rewards: [[steps, return], …], and
    evaluated_s: for each of them the seconds from the call; wall_s: from the call to its return;
    evaluation_s: of it, evaluating; first_update_s: from the call to the end of the first update;
    first_update_at, evaluated_at: the time of that and of the last evaluation's end; overflow: the largest
    share of steps in which the engine lost contacts; peak_bytes: the most device memory in use, if the
    device counts it."""

    from bench.measure.device_memory import peak_bytes
    from bench.measure.turn import Turn
    from core.algorithms.catalog import resolve
    from core.algorithms.events import CheckpointReady
    from core.algorithms.ppo.spec import PPOSpec
    from core.algorithms.run import make_run
    from core.environments import catalog
    from core.physics.choose import engine_builder

    keep_compiled(request)
    info = catalog.find(request["environment"])
    build = engine_builder(request["engine"])
    environment = catalog.make(info, catalog.parse_options(info, {}), build)
    settings = resolve(PPOSpec.model_validate(request["settings"]), info, request.get("device", "cpu"))
    began = time.perf_counter()
    run = make_run(
        environment,
        settings,
        seed=request["seed"],
        checkpoint_every_steps=request["checkpoint_every_steps"],
        devices=request.get("devices", 1),
        epoch_s=request.get("epoch_s", 1.0),
    )
    seen, turn = _Seen(began), Turn()
    for event in run.events():
        seen.take(event)
        if "compile" in seen.phases:
            turn.take()
        if isinstance(event, CheckpointReady) and request["checkpoint_every_steps"]:
            Path(request["cache"], f"checkpoint-{run.step}").write_bytes(run.checkpoint())
        if _long_enough(seen.training, request.get("most_training_s")):
            break
    turn.give()
    told = {name: value for name, value in vars(seen).items() if name != "began"}
    return {**told, "wall_s": time.perf_counter() - began, "peak_bytes": peak_bytes()}


@dataclass
class _Seen:
    """The values that the run's events reported; see `work`."""

    began: float
    training: list[tuple[int, float]] = field(default_factory=list)
    rewards: list[tuple[int, float]] = field(default_factory=list)
    evaluated_s: list[float] = field(default_factory=list)
    phases: dict[str, float] = field(default_factory=dict)
    evaluation_s: float = 0.0
    first_update_s: float = 0.0
    first_update_at: float = 0.0
    evaluated_at: float = 0.0
    overflow: float = 0.0

    def take(self, event: Any) -> None:
        from core.algorithms.events import Evaluated, Phase, Progress

        match event:
            case Phase(name=name, seconds=seconds):
                self.phases[name] = seconds
                if name == "first_update":
                    self.first_update_at, self.first_update_s = time.time(), time.perf_counter() - self.began
            case Progress(step=step, metrics=metrics):
                self.training.append((step, metrics["training/walltime"]))
                self.overflow = max(self.overflow, metrics.get("training/physics_overflow", 0.0))
            case Evaluated(step=step, metrics=metrics):
                self.evaluated_at = time.time()
                self.evaluated_s.append(time.perf_counter() - self.began)
                self.rewards.append((step, metrics["eval/episode_reward"]))
                self.evaluation_s += metrics["eval/epoch_eval_time"]
            case _:
                pass


def _long_enough(training: list[tuple[int, float]], most_s: float | None) -> bool:
    """Whether the training since the first update has used up its time."""
    return most_s is not None and len(training) > 3 and training[-1][1] - training[0][1] > most_s


if __name__ == "__main__":
    answer(work)
