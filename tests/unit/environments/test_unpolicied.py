"""Every family of the catalog rolls out without a trained policy: what a job does to look at a body first."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from core.environments import catalog
from core.environments.environment import Environment
from core.environments.rollout import Roller, constant_policy, random_policy, trajectory_of, zero_policy
from core.environments.trajectory import Trajectory, summary
from core.physics.choose import engine_builder

QUADRUPED = Path(__file__).parents[3] / "examples" / "quadruped.xml"
OTHERS = ["playground/CartpoleBalance", "playground/PointMass", "brax/inverted_pendulum", "brax/reacher"]


def rolled(environment: Environment, num_steps: int = 3) -> Trajectory:
    """An episode each of random actions, of none and of constant ones."""
    size = environment.action_size
    held = jnp.linspace(-1.0, 1.0, size)
    policies = (random_policy(size), zero_policy(size), constant_policy(held.tolist()))

    def act(chosen: jax.Array, observation: jax.Array, key: jax.Array) -> jax.Array:
        return jnp.stack([policy(observation, key) for policy in policies])[chosen]

    roller = Roller(environment, act)  # Compiled once for all three.
    episodes = [
        next(roller.episodes(jnp.int32(kind), jax.random.key(0), num_steps=num_steps, num_episodes=1))
        for kind in range(3)
    ]
    for episode in episodes:
        assert 1 <= episode.num_steps <= num_steps
        assert np.isfinite(episode.qpos).all()
        assert np.isfinite(episode.reward).all()
    random, zero, constant = (episode.action for episode in episodes)
    assert -1.0 <= random.min() < random.max() <= 1.0
    np.testing.assert_array_equal(zero, 0.0)
    np.testing.assert_allclose(constant, np.broadcast_to(held, constant.shape))
    return trajectory_of(environment, episodes)


@pytest.mark.slow  # each compiles an environment
@pytest.mark.timeout(600)
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize(
    "environment_id", [*(info.id for info in catalog.BUILT_IN.values() if not info.takes_model), *OTHERS]
)
def test_rollouts_without_a_policy_work_in_every_family(environment_id: str) -> None:
    info = catalog.find(environment_id)
    engine = engine_builder("native" if info.family == "gaitway" else "mjx")
    trajectory = rolled(catalog.make(info, catalog.parse_options(info, {}), engine))
    assert summary(trajectory)["num_episodes"] == 3


def test_the_quadruped_of_the_examples_stands_while_it_does_nothing() -> None:
    info = catalog.find("mjcf")
    chosen = {
        "model": "sha256:" + "0" * 64,
        "reset": {"keyframe": "home", "position_noise": 0.0, "velocity_noise": 0.0},
    }
    options = catalog.parse_options(info, chosen)
    trajectory = rolled(catalog.make(info, options, engine_builder("native"), QUADRUPED), num_steps=100)
    random, zero, constant = trajectory.episodes
    # An action of zeros is the middle of each control's range, and `home` is made of these: two seconds.
    assert zero.num_steps == 100
    np.testing.assert_allclose(zero.position[-1], [0.0, 0.0, 0.237], atol=0.01)
    # Controls at their ends throw it about.
    for thrown in (random, constant):
        assert np.linalg.norm(thrown.position[-1] - zero.position[-1]) > 0.02
