"""PPO on a GPU, the ant: this project's loop against Brax's."""

from bench.gpu.training import Plan, compare
from bench.measure.result import Options, Result


def measure(options: Options) -> Result:
    """30 M steps under Brax's published settings for its ant."""
    return compare(Plan("ant", num_timesteps=30_000_000, num_evals=4), options)
