"""The jobs that repeat the three notebooks: their numbers, and that no tuned value replaces one of them."""

from math import pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from core.algorithms import catalog as algorithms
from core.algorithms.ppo.spec import PPOSpec
from core.algorithms.run import Schedule
from core.environments import catalog
from core.environments.brittle_star.model import star_model
from core.environments.brittle_star.options import DirectedOptions
from core.environments.info import Device, EnvironmentInfo
from core.jobs.spec import JOB_SPEC, TrainSpec

EXAMPLES = Path(__file__).parents[2] / "examples"
# What the rodent's notebook hands to Brax; the corridor's has no cell that trains.
PPO: dict[str, Any] = {
    "num_timesteps": 10_000_000,
    "reward_scaling": 0.1,
    "episode_length": 1000,
    "normalize_observations": True,
    "action_repeat": 1,
    "unroll_length": 10,
    "num_minibatches": 8,
    "num_updates_per_batch": 4,
    "discounting": 0.98,
    "learning_rate": 3e-4,
    "entropy_cost": 1e-3,
    "num_envs": 2048,
    "batch_size": 512,
}


def read(name: str) -> tuple[TrainSpec, EnvironmentInfo]:
    spec = JOB_SPEC.validate_json((EXAMPLES / f"notebook_{name}.json").read_bytes())
    assert isinstance(spec, TrainSpec)
    info = catalog.find(spec.environment.id)
    return spec, info.under(catalog.parse_options(info, spec.environment.options))


@pytest.mark.parametrize("device", ["cpu", "gpu"])
@pytest.mark.parametrize("name", ["rodent", "corridor", "star"])
def test_nothing_in_it_is_left_to_values_that_are_tuned_here(name: str, device: Device) -> None:
    spec, row = read(name)
    tuned = algorithms.tuned(spec.algorithm.algorithm(), row, device)
    assert tuned.keys() <= spec.algorithm.model_fields_set
    taken = algorithms.environment_options(spec.algorithm, row.id, spec.environment.options)
    assert not taken
    settings = algorithms.resolve(spec.algorithm, row, device)
    assert (
        settings.model_dump(exclude_unset=True).items()
        >= spec.algorithm.model_dump(exclude_unset=True).items()
    )


@pytest.mark.parametrize("name", ["rodent", "corridor"])
def test_brax_gets_the_notebooks_numbers(name: str) -> None:
    spec, row = read(name)
    assert isinstance(spec.algorithm, PPOSpec)
    settings = algorithms.resolve(spec.algorithm, row, "gpu")
    assert PPO.items() <= settings.model_dump().items()
    # Each environment acts 512 · 8 · 10 / 2048 = 20 times in an update, and 10 M steps are 244.1 of these.
    assert (settings.env_steps_per_update, settings.actions_per_update) == (40_960, 20)
    assert settings.num_updates == 245
    # The notebook's 1,000 evaluations would be one after each update.
    wanted = Schedule(settings.num_updates, settings.env_steps_per_update, 1000, None)
    assert all(wanted.evaluation_due(update) for update in range(1, 246))


def test_the_stars_gait_is_the_notebooks_in_radians() -> None:
    spec, row = read("star")
    options = row.option_values
    assert isinstance(options, DirectedOptions)
    gait, model = options.cpg.gait, star_model(options)
    # In the plane ± 45° and out of it ± 30°, where the notebook's star had ± 30° in both.
    in_plane, out_of_plane = model.actuator_ctrlrange[:2, 1]
    half_a_joint = 0.5 * pi / 6
    np.testing.assert_allclose(gait.sweep * in_plane, half_a_joint, rtol=1e-5)
    np.testing.assert_allclose([gait.stroke * out_of_plane, gait.lift * out_of_plane], half_a_joint)
    assert 2 * pi * gait.frequency_hz == pytest.approx(pi)
    assert 2 * pi * gait.lag == pytest.approx(pi / 2)
    assert (row.dt, row.episode_length) == (pytest.approx(0.04), 500)
    # All but the last of an episode's control steps, as the notebook has it: 100 episodes of 499.
    assert spec.algorithm.budget == 49_900
