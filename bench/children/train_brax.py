"""One training by Brax's trainer. Request: as of bench.peers.brax_ppo; mark, or null; epochs; most_s; cache.

epochs: evaluations in the whole budget; most_s: seconds after which it ends at its next evaluation, or null.
"""

import math
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from bench.child import answer
from bench.children.train_ours import keep_compiled


class _Ended(Exception):
    """Brax's trainer stops in no other way."""


def work(request: dict[str, Any]) -> dict[str, Any]:
    """As bench.children.train_ours answers, without the first update; rates are without evaluations."""
    from bench.peers.brax_ppo import trainer

    keep_compiled(request["cache"], request["engine"])
    train, mark = trainer(request), request["mark"]
    policies, confirming = list[Any](), list[float]()
    told: dict[str, Any] = {"training": [], "curve": [], "reached_s": None, "reached_at": None}

    def keep(_: int, make_policy: Callable[..., Any], params: Any) -> None:
        policies[:] = [make_policy(params, deterministic=True)]

    def report(step: int, metrics: dict[str, Any]) -> None:
        seconds = time.perf_counter() - began - sum(confirming)
        if "training/walltime" in metrics:
            told["training"].append((int(step), float(metrics["training/walltime"])))
        if mark is None:
            return
        value = _value(metrics, mark["metric"])
        told["curve"].append((int(step), value, seconds))
        if value >= mark["least"] and step:
            reached_at, before = time.time(), time.perf_counter()
            again = _value(_evaluated(train.args[0], policies[0], request), mark["metric"])
            confirming.append(time.perf_counter() - before)
            if again >= mark["least"]:
                told.update(reached_s=seconds, reached_at=reached_at)
                raise _Ended
        if seconds > (request["most_s"] or math.inf):
            raise _Ended

    began = time.perf_counter()
    with suppress(_Ended):
        train(
            num_evals=request["epochs"] + 1,  # One comes before the first epoch.
            run_evals=mark is not None,
            num_eval_envs=request["episodes"],
            progress_fn=report,
            policy_params_fn=keep,
        )
    return told


def _value(metrics: dict[str, Any], metric: str) -> float:
    if metric == "eval/forward_speed":
        return float(metrics["eval/episode_x_velocity"] / metrics["eval/avg_episode_length"])
    return float(metrics[metric])


def _evaluated(environment: Any, policy: Any, request: dict[str, Any]) -> dict[str, Any]:
    """The metrics of episodes with other starts than Brax's own evaluations have."""
    import jax
    from brax.envs.wrappers.training import wrap
    from brax.training.acting import Evaluator

    length = request["settings"].get("episode_length", 1000)
    evaluator = Evaluator(
        wrap(environment, episode_length=length),
        lambda _: policy,
        num_eval_envs=request["episodes"],
        episode_length=length,
        action_repeat=1,
        key=jax.random.PRNGKey(request["seed"] + 1_000),  # Brax's wrappers take no key of the new kind.
    )
    return evaluator.run_evaluation(None, training_metrics={})


if __name__ == "__main__":
    answer(work)
