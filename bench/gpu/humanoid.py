"""PPO on a GPU, the humanoid: this project's loop against Brax's."""

from bench.gpu.training import Plan, compare
from bench.measure.result import Options, Result


def measure(options: Options) -> Result:
    """20 M steps under Brax's published settings for its humanoid.

    Brax runs three epochs: it compiles in the first two, and the rate is taken from the third.
    """
    return compare(Plan("humanoid", num_timesteps=20_000_000, num_evals=4), options)
