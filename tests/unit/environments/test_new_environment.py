"""An environment that the project does not have: its page, and its line in the catalog."""

import json
from typing import Any

import pytest

from core.adapters.postgres.store import PostgresJobStore
from core.algorithms.catalog import resolve
from core.algorithms.events import Evaluated
from core.algorithms.run import make_run
from core.environments import catalog
from core.errors import Rejected
from core.jobs.checks import check
from core.jobs.spec import JOB_SPEC
from core.physics.availability import choose
from core.physics.choose import engine_builder
from tests.learning.runs import STEPS_PER_UPDATE, small_settings
from tests.unit.environments.sled import INFO


@pytest.fixture(autouse=True)
def line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(catalog.ENVIRONMENTS, INFO.id, INFO)


def test_a_job_may_name_it(job_store: PostgresJobStore) -> None:
    sent = {"kind": "train", "environment": "sled", "algorithm": {"num_timesteps": 1_000}}
    spec = JOB_SPEC.validate_json(json.dumps(sent))
    check(spec, job_store)
    misspelt = JOB_SPEC.validate_python({"kind": "train", "environment": "sledge"})
    with pytest.raises(Rejected, match="Did you mean 'sled'"):
        check(misspelt, job_store)


def test_its_row_is_that_of_its_model_and_its_terms() -> None:
    info, options = catalog.resolve("sled", {"forward_reward_weight": 2.0})
    assert (info.observation_size, info.action_size, info.dt, info.tracked_body) == (2, 1, 0.02, "sled")
    assert [one.components for one in info.spaces.observation] == [("rail",), ("rail",)]
    assert catalog.make(info, options, engine_builder("native")).dt == info.dt


def test_auto_takes_the_engine_that_its_row_names() -> None:
    info = catalog.find("sled")
    assert choose("auto", "gpu", 4096, info.on_a_gpu).reason == "One mass is no work for a GPU."


def test_it_trains() -> None:
    info = catalog.find("sled")
    environment = catalog.make(info, catalog.parse_options(info, {}), engine_builder("native"))
    changes: dict[str, Any] = {"num_timesteps": 20 * STEPS_PER_UPDATE, "episode_length": 100, "num_evals": 2}
    settings = resolve(small_settings(**changes), info, "cpu")
    run = make_run(environment, settings, seed=0, checkpoint_every_steps=None)
    first, last = [event.metrics for event in run.events() if isinstance(event, Evaluated)]
    assert last["eval/episode_reward"] > first["eval/episode_reward"]
