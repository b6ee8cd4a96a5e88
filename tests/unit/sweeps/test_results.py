"""The results of trials: the GPU hours that they used, and the metrics that an objective may name."""

from collections.abc import Sequence
from datetime import timedelta
from pathlib import Path

import jax
import pytest

from core.environments import catalog
from core.jobs.job import Job
from core.jobs.spec import JOB_SPEC, JobSpec
from core.physics.choose import engine_builder
from core.reasons import Reason
from core.sweeps.results import _OF_CLIPS, _terms, judged, metrics_of, refusal_of_metric
from tests.unit.environments.test_imitating_bodies import BODIES, FOLLOWS, at_rest
from tests.unit.sweeps.making import JOB, NOON, sweep_of, trial_of

HOUR = timedelta(hours=1)
# The others take some seconds each.
_QUICK = ("ant", "half_cheetah", "inverted_pendulum", "reacher")
_TERMS = _terms()


@pytest.mark.parametrize(
    ("device", "gpus", "hours"),
    [("gpu: H100", 1, 1.0), ("gpu: H100", 2, 2.0), ("cpu", 1, 0.0), (None, 1, 0.0)],
    ids=["one gpu", "two gpus", "cpu", "nothing said"],
)
def test_gpu_hours_are_those_of_the_gpus_that_it_held(device: str | None, gpus: int, hours: float) -> None:
    spec = JOB_SPEC.validate_python({**JOB, "resources": {"gpus": gpus}})
    job = Job(id="019aa3c2f0b1-5be0c1d2e3", spec=spec, created_at=NOON).claimed("w", NOON)
    job = job.running(device=device).requeued(Reason.WORKER_LOST, "", NOON + HOUR)
    trial = judged(trial_of(0), job, sweep_of().spec.objectives, NOON + 2 * HOUR)
    assert trial.gpu_hours == pytest.approx(hours)


@pytest.mark.parametrize(
    "environment_id",
    [
        *_QUICK,
        *(pytest.param(name, marks=pytest.mark.slow) for name in _TERMS if name not in _QUICK),
    ],
)
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # Brax's.
def test_the_table_has_the_terms_of_the_loaded_environment(environment_id: str) -> None:
    info, options = catalog.resolve(environment_id, {})
    environment = catalog.make(info, options, engine_builder("mjx" if "/" in environment_id else "native"))
    state = jax.eval_shape(environment.reset, jax.random.key(0))
    assert sorted(state.metrics) == list(_TERMS[environment_id])


def job(environment: object = "ant", **said: object) -> JobSpec:
    return JOB_SPEC.validate_python({"kind": "train", "environment": environment, **said})


@pytest.mark.parametrize(
    ("spec", "metrics"),
    [
        (
            job(),
            ["eval/episode_reward", "eval/forward_speed", "eval/episode_reward_ctrl", "training/kl_mean"],
        ),
        (job(algorithm={"kind": "sac"}), ["training/q_value"]),
        # Its reward's terms are named by its options.
        (job({"id": "mjcf", "options": {"model": "sha256:" + "0" * 64}}), ["eval/episode_reward_anything"]),
        # So are those of a body that imitates, though the table has it for another task.
        (
            job({"id": "rodent", "options": FOLLOWS}, battery=True),
            ["eval/episode_reward_track_joints", "eval/episode_clip_followed", "battery/reached"],
        ),
        (job(kind="rollout", policy={"kind": "random"}), ["eval/episode_reward", "eval/avg_episode_length"]),
    ],
)
def test_what_a_job_reports_may_be_an_objective(spec: JobSpec, metrics: Sequence[str]) -> None:
    assert [refusal_of_metric(spec, metric) for metric in metrics] == [None] * len(metrics)


@pytest.mark.parametrize(
    ("spec", "metric", "near"),
    [
        (job(), "reward", "eval/episode_reward"),
        (job(), "training/q_value", None),
        (job("inverted_pendulum"), "eval/forward_speed", None),
        (job(kind="rollout", policy={"kind": "random"}), "training/sps", None),
        (job({"id": "mjcf", "options": {"model": "sha256:" + "0" * 64}}), "eval/nothing", None),
        (job(algorithm={"kind": "ppo", "num_evals": 0}), "eval/episode_reward", "num_evals"),
    ],
)
def test_what_it_does_not_report_is_refused_with_what_it_does(
    spec: JobSpec, metric: str, near: str | None
) -> None:
    refusal = refusal_of_metric(spec, metric)
    assert refusal is not None
    assert f"reports no metric {metric!r}" in refusal
    assert near is None or f"`{near}`" in refusal


def test_what_is_listed_for_an_environment_and_an_algorithm_is_accepted() -> None:
    job = {"kind": "train", "environment": "half_cheetah", "algorithm": {"kind": "sac"}}
    listed = metrics_of("half_cheetah", "sac")
    assert {"eval/episode_reward_run", "eval/forward_speed", "training/q_value"} <= listed
    assert "training/v_loss" not in listed
    assert {refusal_of_metric(JOB_SPEC.validate_python(job), metric) for metric in listed} == {None}
    assert "eval/episode_reward_std" in metrics_of("half_cheetah", None)
    assert "training/sps" not in metrics_of("half_cheetah", None)


def test_what_is_listed_of_a_body_that_imitates_is_that_of_its_clips() -> None:
    listed = metrics_of("rodent", "ppo", follows_clips=True)
    assert {"eval/episode_clip_followed", "eval/forward_speed", "training/kl_mean"} <= listed
    assert "eval/episode_forward_reward" not in listed


@pytest.mark.parametrize("body", BODIES)
def test_a_body_that_imitates_reports_what_is_listed(body: str, tmp_path: Path) -> None:
    info, options = catalog.resolve(body, FOLLOWS)
    clips = at_rest(body, tmp_path / "clips.npz")
    environment = catalog.make(info, options, engine_builder("native"), clips=clips)
    state = jax.eval_shape(environment.reset, jax.random.key(0))
    assert set(_OF_CLIPS) <= set(state.metrics)
