"""The job that the demo sends."""

from pathlib import Path

import pytest

from core.jobs.resolved import resolve_job
from core.jobs.spec import TrainSpec
from gaitway.service.demo import DemoOptions


def _job(environment: str, num_timesteps: int | None = None) -> TrainSpec:
    options = DemoOptions(Path(), environment, num_timesteps, seed=3, port=None)
    return TrainSpec.model_validate(options.specification())


def test_the_ants_starts_have_little_noise_and_its_learning_slows_down() -> None:
    job = _job("ant")
    resolved = resolve_job(job)
    settings = resolved.settings["cpu"]
    assert resolved.options.model_dump()["reset_noise_scale"] == 0.02
    assert settings.model_dump()["learning_rate_schedule"] == "LINEAR"
    assert settings.budget == 1_200_000
    assert job.seed == 3


@pytest.mark.parametrize("environment", ["ant", "hopper"])
def test_a_given_number_of_steps_counts(environment: str) -> None:
    assert _job(environment, 40_960).algorithm.budget == 40_960


def test_another_body_trains_under_its_own_settings() -> None:
    job = _job("hopper")
    assert job.environment.options == {}
    assert job.algorithm.model_dump(exclude_unset=True) == {"kind": "ppo"}


def test_a_robot_is_tested_in_the_end() -> None:
    assert _job("go1").battery is not None
    assert _job("hopper").battery is None
