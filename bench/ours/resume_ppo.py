"""Whether a training gives the same bits again: `python -m bench.ours.resume_ppo FOLDER`.

Request: environment, engine, settings (hyperparameters), seed; device; deterministic: whether XLA may use
only operations that give the same bits every time.
"""

import os
from hashlib import sha256
from typing import Any

from bench.measure.child import answer

_DETERMINISTIC = "--xla_gpu_deterministic_ops=true"


def work(request: dict[str, Any]) -> dict[str, Any]:
    """twice: whether a second run made the same checkpoints, byte for byte. resumed: whether one ended alike
    that went on from the first one's checkpoint in the middle. steps_per_s: of the second run, without its
    first update, which compiles. num_checkpoints: that were compared; bytes: the size of the last."""
    if request["deterministic"]:
        os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {_DETERMINISTIC}"
    from core.algorithms.catalog import resolve
    from core.algorithms.ppo.spec import PPOSpec
    from core.environments import catalog
    from core.physics.choose import engine_builder

    info = catalog.find(request["environment"])
    environment = catalog.make(info, catalog.parse_options(info, {}), engine_builder(request["engine"]))
    settings = resolve(PPOSpec.model_validate(request["settings"]), info, request["device"])
    updates = settings.num_timesteps // settings.env_steps_per_update
    middle = updates // 2 * settings.env_steps_per_update

    def run(**more: Any) -> tuple[dict[int, bytes], float]:
        return _checkpoints(environment, settings, request["seed"], middle, more)

    first, _ = run()
    second, rate = run()
    resumed, _ = run(resume=first[middle])
    end = max(first)
    return {
        "twice": {step: _digest(one) for step, one in first.items()}
        == {step: _digest(one) for step, one in second.items()},
        "resumed": _digest(resumed[end]) == _digest(first[end]),
        "steps_per_s": rate,
        "num_checkpoints": len(first),
        "bytes": len(first[end]),
    }


def _checkpoints(
    environment: Any, settings: Any, seed: int, middle: int, more: dict[str, Any]
) -> tuple[dict[int, bytes], float]:
    """The checkpoints by step, and steps per second after the first update."""
    from core.algorithms.events import CheckpointReady, Progress
    from core.algorithms.run import make_run

    found, reports = dict[int, bytes](), list[tuple[int, float]]()
    run = make_run(environment, settings, seed=seed, checkpoint_every_steps=middle, **more)
    for event in run.events():
        match event:
            case CheckpointReady():
                found[run.step] = run.checkpoint()
            case Progress(step=step, metrics=metrics):
                reports.append((step, metrics["training/walltime"]))
            case _:
                pass
    (begun, begun_at), (ended, ended_at) = reports[0], reports[-1]
    return found, (ended - begun) / (ended_at - begun_at) if ended > begun else 0.0


def _digest(checkpoint: bytes) -> str:
    return sha256(checkpoint).hexdigest()


if __name__ == "__main__":
    answer(work)
