"""The same on a GPU, beside MuJoCo Warp: see bench.cpu.own_models."""

from bench.cpu.own_models import measured
from bench.measure import requests
from bench.measure.result import Options, Result


def measure(options: Options) -> Result:
    """On a GPU; where the bench is only tried out, on a CPU without one."""
    return measured(options, "gpu_own_models", requests.gpu("gpu_own_models", options))
