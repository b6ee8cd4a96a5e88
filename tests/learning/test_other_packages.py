"""Environments of other packages under the real trainer."""

from typing import Any

import pytest

from core.environments import catalog
from core.environments.environment import Environment
from core.physics.choose import engine_builder
from tests.learning.runs import STEPS_PER_UPDATE, checkpoints, small_run


def make(environment_id: str, **options: Any) -> Environment:
    info = catalog.find(environment_id)
    return catalog.make(info, catalog.parse_options(info, options), engine_builder("mjx"))


@pytest.mark.slow  # MJX and Brax's physics are compiled into the update
@pytest.mark.timeout(600)
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize(
    ("environment_id", "options"),
    [("playground/PendulumSwingup", {}), ("brax/inverted_pendulum", {"backend": "generalized"})],
)
def test_a_resumed_run_of_anothers_environment_equals_an_uninterrupted_one(
    environment_id: str, options: dict[str, Any]
) -> None:
    # Two updates of 16 steps for each environment, whose episodes end after 5: fresh starts come from the
    # pool.
    budget = {
        "num_timesteps": 2 * STEPS_PER_UPDATE,
        "episode_length": 5,
        "num_evals": 1,
        "reset_pool_size": 4,
        "num_eval_envs": 2,
    }
    straight = checkpoints(
        small_run(make(environment_id, **options), checkpoint_every_steps=STEPS_PER_UPDATE, **budget)
    )
    resumed = small_run(make(environment_id, **options), resume=straight[STEPS_PER_UPDATE], **budget)
    assert checkpoints(resumed) == {2 * STEPS_PER_UPDATE: straight[2 * STEPS_PER_UPDATE]}
