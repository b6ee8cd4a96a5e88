"""One cohort of seeds, trained together: `python -m bench.ours.train_cohort FOLDER`.

Request: as for bench.ours.train_ppo, with seeds (numbers) for seed.
"""

import time
from typing import Any

from bench.measure.cache import keep_compiled
from bench.measure.child import answer


def work(request: dict[str, Any]) -> dict[str, Any]:
    """training: [[steps of each, seconds of training until then], …]; rewards: [[steps, mean return over
    the seeds], …]; returns: of each seed, at the last evaluation; phases: seconds of trace, compile,
    first_update; wall_s: from the call to its return; peak_bytes: the most device memory in use, if the
    device counts it."""

    from bench.measure.device_memory import peak_bytes
    from core.algorithms.catalog import resolve
    from core.algorithms.cohort import CohortRun
    from core.algorithms.events import Evaluated, Phase, Progress
    from core.algorithms.ppo.algorithm import PPO
    from core.algorithms.ppo.spec import PPOSpec
    from core.environments import catalog
    from core.physics.choose import engine_builder

    keep_compiled(request)
    info = catalog.find(request["environment"])
    environment = catalog.make(info, catalog.parse_options(info, {}), engine_builder(request["engine"]))
    settings = resolve(PPOSpec.model_validate(request["settings"]), info, request.get("device", "cpu"))
    began = time.perf_counter()
    members = [PPO(environment, settings, seed=seed) for seed in request["seeds"]]
    run = CohortRun(members, checkpoint_every_steps=request["checkpoint_every_steps"])
    training, rewards = list[tuple[int, float]](), list[tuple[int, float]]()
    returns, phases = list[float](), dict[str, float]()
    for moment in run.moments():
        seen = [what for _, what in moment]
        match seen[0]:
            case Phase(name=name, seconds=seconds):
                phases[name] = seconds
            case Progress(step=step, metrics=metrics):
                training.append((step, metrics["training/walltime"]))
            case Evaluated(step=step):
                returns = [one.metrics["eval/episode_reward"] for one in seen if isinstance(one, Evaluated)]
                rewards.append((step, sum(returns) / len(returns)))
            case _:
                pass
    return {
        "training": training,
        "rewards": rewards,
        "returns": returns,
        "phases": phases,
        "wall_s": time.perf_counter() - began,
        "peak_bytes": peak_bytes(),
    }


if __name__ == "__main__":
    answer(work)
