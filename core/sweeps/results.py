"""The results of trials: the metrics that a job can be judged by, outcomes, the best trials, the seeds of one
setting together, and the importance of each axis."""

import json
import warnings
from collections import defaultdict
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from datetime import datetime
from functools import cache
from importlib.resources import files
from operator import ge
from statistics import fmean, stdev

from pydantic import JsonValue

from core.algorithms.battery.result import metric_names
from core.errors import Misconfigured
from core.jobs.job import Attempt, Job, UnreadableJob
from core.jobs.spec import JobSpec, RolloutSpec
from core.jobs.status import JobStatus
from core.nearest import nearest
from core.sweeps.spec import Objective, SweepSpec
from core.sweeps.sweep import Outcome, SeenTrial, Trial

_OUTCOMES: dict[JobStatus, Outcome] = {
    JobStatus.SUCCEEDED: "succeeded",
    JobStatus.FAILED: "failed",
    JobStatus.CANCELLED: "cancelled",
}
SEED = "seed"
_LEAST_TRIALS = 4
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
    "ppo": {
        *("total_loss", "policy_loss", "v_loss", "entropy_loss", "kl_mean", "learning_rate", "grad_norm"),
        *("latent_kl", "latent_std", "latent_step", "kl_weight"),
    },
    "sac": {"critic_loss", "policy_loss", "q_value", "entropy", "alpha"},
    "dqn": {"loss", "q_value", "td_error", "epsilon"},
    "distillation": {
        *("total_loss", "action_error", "beta", "grad_norm"),
        *("latent_kl", "latent_std", "latent_step", "kl_weight"),
    },
    "q_learning": {"episodes", "num_episodes", "epsilon"},
}
# The metrics that every task with a reference reports.
_OF_CLIPS = ("root_error", "root_turn_error", "joint_error", "body_error", "clip_followed", "x_velocity")


def judged(
    trial: Trial, job: Job | UnreadableJob | None, objectives: Sequence[Objective], now: datetime
) -> Trial:
    """The trial as its job is now; with an outcome once that has ended. job: None if it was deleted."""
    if trial.outcome is not None:
        return trial
    if job is None:
        return trial.model_copy(update={"outcome": "deleted", "job": None, "finished_at": now})
    outcome = _OUTCOMES.get(job.status)
    if isinstance(job, UnreadableJob):
        message = f"This version cannot read its record ({job.problem})."
        return trial.model_copy(
            update={"outcome": outcome, "message": message, "finished_at": job.finished_at}
        )
    # One that succeeded before the cancel reached it has its last value.
    if trial.is_pruned and outcome == "cancelled":
        outcome = "pruned"
    metrics = job.progress.metrics
    return trial.model_copy(
        update={
            "outcome": outcome,
            "message": job.message,
            "values": tuple(metrics.get(objective.metric) for objective in objectives),
            # A run that resumes counts from the beginning of its lineage, and each of several seeds its own.
            "steps": max(0, job.progress.step - trial.inherited_steps) * max(1, len(job.seeds)),
            "gpu_hours": sum(_gpu_hours(one, job.spec.resources.gpus, now) for one in job.attempts),
            "finished_at": job.finished_at,
        }
    )


def _gpu_hours(attempt: Attempt, gpus: int, now: datetime) -> float:
    """Hours of the GPUs that the attempt held; 0 on a CPU, or before it has reported its device."""
    if attempt.device is None or attempt.device.startswith("cpu"):
        return 0.0
    return gpus * ((attempt.ended_at or now) - attempt.started_at).total_seconds() / 3600


def best(trials: Sequence[Trial], objectives: Sequence[Objective]) -> list[Trial]:
    """The best trial so far; with several objectives, those that no other one beats in all (Pareto).

    Pruned trials and those that run do not count: their last value is not their end.
    """
    ended = [trial for trial in trials if trial.outcome == "succeeded" and trial.has_values]
    worth = {trial.number: _worth(trial, objectives) for trial in ended}
    if len(objectives) == 1:
        return [max(ended, key=lambda trial: worth[trial.number])] if ended else []
    # One that is better in the first objective, or equal there and better in the next, is never beaten by a
    # later one, so each is compared only with those that nothing has beaten.
    front = list[Trial]()
    for one in sorted(ended, key=lambda trial: worth[trial.number], reverse=True):
        if not any(_beats(worth[other.number], worth[one.number]) for other in front):
            front.append(one)
    return sorted(front, key=lambda trial: trial.number)


def _worth(trial: Trial, objectives: Sequence[Objective]) -> list[float]:
    """Its values, of which more is better."""
    return [one.sign * (value or 0.0) for one, value in zip(objectives, trial.values, strict=True)]


def _beats(one: Sequence[float], other: Sequence[float]) -> bool:
    return one != other and all(map(ge, one, other))


@dataclass(frozen=True)
class TrialGroup:
    """The trials of one setting, which differ in their seeds alone.

    mean, spread: of each objective over the trials that succeeded; spread is their standard deviation, None
    of fewer than two.
    """

    parameters: dict[str, JsonValue]
    trials: list[int]
    mean: list[float | None]
    spread: list[float | None]


def by_seed(trials: Sequence[Trial], num_objectives: int) -> list[TrialGroup]:
    """One group for each setting; empty where `seed` is no axis."""
    groups: dict[str, list[Trial]] = defaultdict(list)
    for trial in trials:
        if SEED in trial.parameters:
            groups[json.dumps(_setting(trial), sort_keys=True)].append(trial)
    return [_group(members, num_objectives) for members in groups.values()]


def _setting(trial: Trial) -> dict[str, JsonValue]:
    return {name: value for name, value in trial.parameters.items() if name != SEED}


def _group(members: Sequence[Trial], num_objectives: int) -> TrialGroup:
    ended = [trial.values for trial in members if trial.outcome == "succeeded" and trial.has_values]
    columns = [[float(row[at] or 0.0) for row in ended] for at in range(num_objectives)]
    return TrialGroup(
        _setting(members[0]),
        [trial.number for trial in members],
        [fmean(column) if column else None for column in columns],
        [stdev(column) if len(column) > 1 else None for column in columns],
    )


def importance(
    spec: SweepSpec, seen: Sequence[SeenTrial]
) -> tuple[Mapping[str, Mapping[str, float]] | None, str | None]:
    """The share of each axis in what makes trials differ, by objective; or None, and why: a sentence.

    By PED-ANOVA (Watanabe et al., 2023) in Optuna.
    """
    if spec.population is not None:
        return None, "The method `pbt` changes settings while a run trains, so no setting has a result alone."
    succeeded = [one for one in seen if one.trial.outcome == "succeeded" and one.trial.has_values]
    if len(succeeded) < _LEAST_TRIALS:
        return None, f"It needs {_LEAST_TRIALS} trials that succeeded, and has {len(succeeded)}."
    for at, objective in enumerate(spec.objectives):
        if len({one.trial.values[at] for one in succeeded}) == 1:
            return None, f"All trials have the same {objective.metric}."
    try:
        return _by_ped_anova(spec, succeeded), None
    except Misconfigured as error:
        return None, error.detail


def _by_ped_anova(spec: SweepSpec, succeeded: Sequence[SeenTrial]) -> Mapping[str, Mapping[str, float]]:
    from core.sweeps import samplers

    optuna = samplers.optuna
    with warnings.catch_warnings(category=optuna.exceptions.ExperimentalWarning, action="ignore"):
        evaluator = optuna.importance.PedAnovaImportanceEvaluator()
    found: dict[str, dict[str, float]] = {}
    for at, objective in enumerate(spec.objectives):
        alone = spec.model_copy(update={"objective": objective})
        study = samplers.study_of(alone, [_with_one_value(one, at) for one in succeeded])
        shares = optuna.importance.get_param_importances(study, evaluator=evaluator)
        found[objective.metric] = {name: float(shares.get(name, 0.0)) for name in spec.parameters}
    return found


def _with_one_value(one: SeenTrial, at: int) -> SeenTrial:
    return replace(one, trial=one.trial.model_copy(update={"values": (one.trial.values[at],)}))


def metrics_of(environment: str, algorithm: str | None, *, follows_clips: bool = False) -> Set[str]:
    """The metrics that a job on the environment reports. algorithm: None for a rollout.

    Where an environment's terms depend on its options, they are not among them. A body that follows clips
    does so by other terms than those of the table.
    """
    if algorithm is None:
        return _ROLLOUT
    terms = _OF_CLIPS if follows_clips else _terms().get(environment)
    known = _EVALUATION | _TRAINING | {f"training/{name}" for name in _OF_ALGORITHMS.get(algorithm, ())}
    known |= {f"eval/episode_{name}" for name in terms or ()}
    if terms is not None and "x_velocity" not in terms:
        known.discard("eval/forward_speed")
    return known


def refusal_of_metric(spec: JobSpec, metric: str) -> str | None:
    """Why the job does not report this metric, as a sentence; None if it does, or may.

    Any term of an episode passes where the environment's terms depend on its options: it is not in the table,
    or follows clips, by terms of its own.
    """
    if not isinstance(spec, RolloutSpec) and spec.algorithm.num_evals == 0 and metric.startswith("eval/"):
        return f"The job makes no evaluations (its `num_evals` is 0), so it reports no metric {metric!r}."
    algorithm = None if isinstance(spec, RolloutSpec) else spec.algorithm.algorithm()
    environment, follows_clips = spec.environment.id, _follows_clips(spec)
    known = {*metrics_of(environment, algorithm, follows_clips=follows_clips), *_of_the_battery(spec)}
    is_open = algorithm is not None and (follows_clips or environment not in _terms())
    if is_open and metric.startswith("eval/episode_"):
        return None
    if metric in known:
        return None
    near = nearest(metric, sorted(known)) or ["eval/episode_reward"]
    return f"A job of this kind on {environment} reports no metric {metric!r}; did you mean `{near[0]}`?"


def _of_the_battery(spec: JobSpec) -> Sequence[str]:
    if spec.battery is None:
        return []
    return metric_names(spec.battery.bounds, of_clips=_follows_clips(spec))


def _follows_clips(spec: JobSpec) -> bool:
    return bool(spec.environment.options.get("reference"))


@cache
def _terms() -> Mapping[str, Sequence[str]]:
    """The metrics of each environment, which only its loaded code knows; a test compares the two."""
    return json.loads((files("core.sweeps") / "environment_metrics.json").read_text())
