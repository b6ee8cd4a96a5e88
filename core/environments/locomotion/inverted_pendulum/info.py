"""The inverted pendulum's row in the catalog."""

from core.environments.info import EnvironmentInfo
from core.physics.availability import Rule

INFO = EnvironmentInfo(
    id="inverted_pendulum",
    description="A pole on a cart with one motor, rewarded for each step in which the pole stands.",
    factory="core.environments.locomotion.inverted_pendulum.environment:make",
    observation_size=4,
    action_size=1,
    dt=0.04,
    episode_length=1000,
    tracked_body="cart",
    on_a_gpu=(Rule("warp", 1024, "Measured on an H200: 1.54 M training steps/s, 635 k by mjx."),),
    tuned={
        "ppo": {
            "cpu": {
                "num_timesteps": 500_000,
                "num_envs": 128,
                "unroll_length": 10,
                "batch_size": 128,
                "num_minibatches": 8,
                "num_updates_per_batch": 4,
                "learning_rate": 6e-4,
                "discounting": 0.97,
                "entropy_cost": 1e-3,
                "reward_scaling": 1.0,
                "normalize_observations": True,
            },
            "gpu": {
                "num_timesteps": 2_000_000,
                "num_evals": 1,
                "num_envs": 2048,
                "unroll_length": 5,
                "batch_size": 1024,
                "num_minibatches": 32,
                "num_updates_per_batch": 4,
                "learning_rate": 3e-4,
                "discounting": 0.97,
                "entropy_cost": 1e-2,
                "reward_scaling": 10.0,
                "normalize_observations": True,
            },
        }
    },
)
