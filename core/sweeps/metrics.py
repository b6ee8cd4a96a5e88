"""The metrics that a job reports, as far as its specification tells: an objective must be one of them."""

import json
from collections.abc import Mapping, Sequence, Set
from functools import cache
from importlib.resources import files

from core.jobs.spec import JobSpec, RolloutSpec
from core.nearest import nearest

_ROLLOUT = {"eval/episode_reward", "eval/episode_reward_std", "eval/avg_episode_length", "eval/forward_speed"}
_EVALUATION = {*_ROLLOUT, "eval/epoch_eval_time", "eval/walltime", "eval/walltime_share"}
_TRAINING = {
    "training/sps",
    "training/walltime",
    "training/episode_reward",
    "training/episode_length",
    "training/fall_rate",
}
_OF_ALGORITHMS = {
    "ppo": {"total_loss", "policy_loss", "v_loss", "entropy_loss", "kl_mean", "learning_rate", "grad_norm"},
    "sac": {"critic_loss", "policy_loss", "q_value", "entropy", "alpha"},
    "dqn": {"loss", "q_value", "td_error", "epsilon"},
    "q_learning": {"episodes", "num_episodes", "epsilon"},
}


def metrics_of(environment: str, algorithm: str | None) -> Set[str]:
    """The metrics that a job on the environment reports. algorithm: None for a rollout.

    Where an environment's terms depend on its options, they are not among them.
    """
    if algorithm is None:
        return _ROLLOUT
    terms = _terms().get(environment)
    known = _EVALUATION | _TRAINING | {f"training/{name}" for name in _OF_ALGORITHMS.get(algorithm, ())}
    known |= {f"eval/episode_{name}" for name in terms or ()}
    if terms is not None and "x_velocity" not in terms:
        known.discard("eval/forward_speed")
    return known


def refusal_of_metric(spec: JobSpec, metric: str) -> str | None:
    """Why the job does not report this metric, as a sentence; None if it does, or may.

    An environment whose terms depend on its options is not in the table: any term of an episode passes.
    """
    if not isinstance(spec, RolloutSpec) and spec.algorithm.num_evals == 0 and metric.startswith("eval/"):
        return f"The job makes no evaluations (its `num_evals` is 0), so it reports no metric {metric!r}."
    algorithm = None if isinstance(spec, RolloutSpec) else spec.algorithm.algorithm()
    known = metrics_of(spec.environment.id, algorithm)
    is_open = algorithm is not None and spec.environment.id not in _terms()
    if is_open and metric.startswith("eval/episode_"):
        return None
    if metric in known:
        return None
    near = nearest(metric, sorted(known)) or ["eval/episode_reward"]
    return (
        f"A job of this kind on {spec.environment.id} reports no metric {metric!r}; did you mean `{near[0]}`?"
    )


@cache
def _terms() -> Mapping[str, Sequence[str]]:
    """The metrics of each environment, which only its loaded code knows; a test compares the two."""
    return json.loads((files("core.sweeps") / "environment_metrics.json").read_text())
