"""The name and the configuration of a run at Weights & Biases."""

from pathlib import Path
from typing import Any

import pytest

from core.algorithms.catalog import ALGORITHMS
from core.jobs.spec import JOB_SPEC, TrainSpec
from worker.tracking.config import about_run, as_resolved, as_submitted
from worker.tracking.items import About

JOB_ID = "019aa3c2f0b1-5be0c1d2e3"


def spec(**fields: Any) -> TrainSpec:
    tracking = {"wandb": {"project": "vnl", **fields.pop("wandb", {})}}
    made = JOB_SPEC.validate_python(
        {"kind": "train", "environment": "rodent", "tracking": tracking, **fields}
    )
    assert isinstance(made, TrainSpec)
    return made


def about(**fields: Any) -> About:
    run = about_run(JOB_ID, spec(**fields), Path())
    assert run is not None
    return run


@pytest.mark.parametrize(
    ("fields", "name"),
    [
        ({}, "rodent_ppo_5be0c1d2e3"),
        ({"labels": {"task_name": "run"}}, "rodent_run_ppo_5be0c1d2e3"),
        ({"environment": "brax/ant", "algorithm": {"kind": "sac"}}, "brax/ant_sac_5be0c1d2e3"),
        ({"name": "first steps", "labels": {"task_name": "run"}}, "first steps"),
        ({"name": "first steps", "wandb": {"name": "here"}}, "here"),
    ],
)
def test_a_run_is_named_by_its_tracking_or_its_job_or_what_it_is_about(
    fields: dict[str, Any], name: str
) -> None:
    assert about(**fields).name == name


def test_names_and_resolved_hyperparameters_are_flat_beside_the_whole_specification() -> None:
    resolved = as_resolved(
        "cpu × 2", "mjx", {"hyperparameters": {"kind": "ppo", "num_envs": 64}, "host": "a"}
    )
    assert resolved == {
        "num_envs": 64,
        "algorithm": {"kind": "ppo", "num_envs": 64},
        "host": "a",
        "device": "cpu × 2",
        "engine": "mjx",
    }
    config = {**about(seed=7).config, **resolved}
    flat = ("env_name", "algo_name", "num_envs", "seed", "kind", "job")
    assert [config[name] for name in flat] == ["rodent", "ppo", 64, 7, "train", JOB_ID]
    assert config["environment"] == {"id": "rodent", "options": {}}
    assert not {"tracking", "task_name"} & config.keys()


@pytest.mark.parametrize("kind", ALGORITHMS)
def test_no_hyperparameter_has_the_name_of_another_entry(kind: str) -> None:
    others = {*as_submitted(JOB_ID, spec(labels={"task_name": "run"})), *as_resolved(None, None, {})}
    assert not others & (ALGORITHMS[kind].spec.model_fields.keys() - {"kind"})
