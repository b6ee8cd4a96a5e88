"""PPO on a GPU, the humanoid: this project's loop against Brax's."""

from bench.gpu_training import Run, compare
from bench.result import Options, Result


def measure(options: Options) -> Result:
    """20 M steps under Brax's published settings for its humanoid."""
    return compare(Run("humanoid", num_timesteps=20_000_000, num_evals=3), options)
