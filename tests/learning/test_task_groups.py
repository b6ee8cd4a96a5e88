"""A task whose critic sees more than its policy, which sees late and the past: resume, policy, rollout."""

from pathlib import Path

import jax
import numpy as np
import pytest

from core.algorithms.export.network import network_of
from core.algorithms.trained_policy import policy_from_checkpoint
from core.environments.environment import Environment
from core.environments.info import CRITIC_GROUP, POLICY_GROUP
from core.environments.rollout import Roller
from tests.learning.runs import STEPS_PER_UPDATE, checkpoints, small_run
from tests.unit.environments.mjcf.probe import build

JOINTS = {"kind": "joint_positions", "noise": 0.01, "bias": 0.02, "delay": [0.0, 0.02], "history": 2}
EDITS = {"servos": [{"joints": ["elbow"], "kp": 8.0, "effort": 4.0, "velocity_limit": 10.0}]}
ACTION = {"kind": "joint_position", "delay": [0.0, 0.01], "smoothing": 0.3, "torque_speed_curve": True}


def task(folder: Path) -> Environment:
    critic = [JOINTS, {"kind": "base_linear_velocity", "history": 2}]
    return build(folder, edits=EDITS, action=ACTION, observation=[JOINTS], critic=critic)


@pytest.mark.extra
def test_it_resumes_to_the_bit_and_its_policy_reads_the_policys_group(tmp_path: Path) -> None:
    environment = task(tmp_path)
    assert environment.observation_size == {POLICY_GROUP: 2, CRITIC_GROUP: 8}
    settings = {"num_timesteps": 4 * STEPS_PER_UPDATE, "episode_length": 6, "value_obs_key": CRITIC_GROUP}
    run = small_run(environment, checkpoint_every_steps=2 * STEPS_PER_UPDATE, **settings)
    whole = checkpoints(run)
    middle, end = 2 * STEPS_PER_UPDATE, 4 * STEPS_PER_UPDATE
    resumed = small_run(environment, resume=whole[middle], **settings)
    assert checkpoints(resumed)[end] == whole[end]
    network = network_of(run.policy())
    assert (network.observation_name, network.observation_size) == (POLICY_GROUP, 2)
    policy = policy_from_checkpoint(whole[end])
    shown, act = policy.acting(environment)
    (episode,) = Roller(shown, act).episodes(
        policy.parameters, jax.random.key(0), num_steps=5, num_episodes=1
    )
    assert episode.observation.shape == (6, 2)
    # Of each row the second number is the newest, which the next row has first.
    np.testing.assert_array_equal(episode.observation[1:, 0], episode.observation[:-1, 1])
