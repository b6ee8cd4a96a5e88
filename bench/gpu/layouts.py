"""The same on a GPU: see bench.cpu.layouts."""

from bench.cpu.layouts import measured
from bench.measure import requests
from bench.measure.result import Options, Result


def measure(options: Options) -> Result:
    """On a GPU; where the bench is only tried out, on a CPU without one."""
    return measured(options, "gpu_layouts", requests.gpu("gpu_layouts", options))
