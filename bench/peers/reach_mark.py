"""Brax's trainer until the body reaches a mark: `python -m bench.peers.reach_mark FOLDER`.

Request: that of bench.peers.brax_ppo; mark (bench.measure.marks); epochs (evaluations in the whole budget);
most_s (seconds after which the run ends at its next evaluation; may be left out); cache (a folder for
compiled programs, or null).
"""

import math
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from bench.measure.cache import keep_compiled
from bench.measure.child import answer
from bench.measure.marks import NUM_EPISODES


class _Ended(Exception):
    """Brax's trainer stops in no other way."""


def work(request: dict[str, Any]) -> dict[str, Any]:
    """As bench.ours.reach_mark answers, without phases."""
    from bench.peers.brax_ppo import trainer

    keep_compiled(request)
    train, mark = trainer(request), request["mark"]
    policies, confirming = list[Any](), list[float]()
    told: dict[str, Any] = {"curve": [], "reached_s": None, "reached_at": None, "confirmed": None}

    def keep(_: int, make_policy: Callable[..., Any], params: Any) -> None:
        policies[:] = [make_policy(params, deterministic=True)]

    def report(step: int, metrics: dict[str, Any]) -> None:
        value, seconds = _value(metrics, mark["metric"]), time.perf_counter() - began - sum(confirming)
        told["curve"].append((int(step), value, seconds))
        if value >= mark["least"] and step:
            reached_at, before = time.time(), time.perf_counter()
            again = _value(_evaluated(train.args[0], policies[0], request), mark["metric"])
            confirming.append(time.perf_counter() - before)
            if again >= mark["least"]:
                told.update(reached_s=seconds, reached_at=reached_at, confirmed=again)
                raise _Ended
        if seconds > request.get("most_s", math.inf):
            raise _Ended

    began = time.perf_counter()
    with suppress(_Ended):
        train(
            num_evals=request["epochs"] + 1,
            num_eval_envs=NUM_EPISODES,
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
        num_eval_envs=NUM_EPISODES,
        episode_length=length,
        action_repeat=1,
        key=jax.random.PRNGKey(request["seed"] + 1_000),  # Brax's wrappers take no key of the new kind.
    )
    return evaluator.run_evaluation(None, training_metrics={})


if __name__ == "__main__":
    answer(work)
