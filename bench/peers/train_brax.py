"""One run of the peer, `brax.training.agents.ppo.train`: `python -m bench.peers.train_brax FOLDER`.

Request: that of bench.peers.brax_ppo; epochs (it reports after each); evaluate; cache (a folder for compiled
programs, or null).
"""

import time
from typing import Any

from bench.measure.cache import keep_compiled
from bench.measure.child import answer


def work(request: dict[str, Any]) -> dict[str, Any]:
    """training: [[steps, seconds of training until then], …]; rewards: [[steps, return], …], and
    evaluated_s: for each of them the seconds from the call; wall_s: from the call to its return;
    evaluation_s: of it, evaluating; peak_bytes: the most device memory in use, if the device counts it."""

    from bench.measure.device_memory import peak_bytes
    from bench.measure.turn import Turn
    from bench.peers.brax_ppo import trainer

    keep_compiled(request)
    train = trainer(request)
    training, rewards = list[tuple[int, float]](), list[tuple[int, float]]()
    evaluated_s, evaluation_s = list[float](), 0.0

    def report(step: int, metrics: dict[str, Any]) -> None:
        nonlocal evaluation_s
        if "training/walltime" in metrics:
            training.append((int(step), float(metrics["training/walltime"])))
        if "eval/episode_reward" in metrics:
            rewards.append((int(step), float(metrics["eval/episode_reward"])))
            evaluated_s.append(time.perf_counter() - began)
            evaluation_s = float(metrics["eval/walltime"])

    with Turn():  # Includes compilation: Brax runs its first epoch before it reports anything.
        began = time.perf_counter()
        # One evaluation comes before the first epoch.
        train(num_evals=request["epochs"] + 1, run_evals=request["evaluate"], progress_fn=report)
        wall_s = time.perf_counter() - began
    return {
        "training": training,
        "rewards": rewards,
        "evaluated_s": evaluated_s,
        "wall_s": wall_s,
        "evaluation_s": evaluation_s,
        "peak_bytes": peak_bytes(),
    }


if __name__ == "__main__":
    answer(work)
