"""The reacher's row in the catalog."""

from core.environments.info import EnvironmentInfo
from core.physics.availability import Rule

INFO = EnvironmentInfo(
    id="reacher",
    description="An arm of two links in a plane, rewarded for bringing its tip to a target.",
    factory="core.environments.locomotion.reacher.environment:make",
    observation_size=11,
    action_size=2,
    dt=0.02,
    episode_length=1000,
    tracked_body="body0",
    on_a_gpu=(Rule("warp", 1024, "Measured on an H200: 921 k training steps/s, 306 k by mjx."),),
    tuned={
        "ppo": {
            "cpu": {
                "num_timesteps": 5_000_000,
                "num_envs": 256,
                "unroll_length": 20,
                "batch_size": 128,
                "num_minibatches": 16,
                "num_updates_per_batch": 4,
                "learning_rate": 6e-4,
                "discounting": 0.95,
                "entropy_cost": 1e-3,
                "reward_scaling": 5.0,
                "normalize_observations": True,
            },
            "gpu": {
                "num_timesteps": 50_000_000,
                "num_evals": 2,
                "num_envs": 2048,
                "unroll_length": 50,
                "batch_size": 256,
                "num_minibatches": 32,
                "num_updates_per_batch": 8,
                "learning_rate": 3e-4,
                "discounting": 0.95,
                "entropy_cost": 1e-3,
                "reward_scaling": 5.0,
                "normalize_observations": True,
            },
        }
    },
)
