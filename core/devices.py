"""A worker's device, by name: `cpu`, a GPU (`gpu:0`), or several of one host (`gpu:0,1`)."""

import os
import re
import sys
from collections.abc import Iterable

# How the GPUs of a worker may be named; `gpu` is the first.
GPUS = r"gpu(:\d{1,3}(-\d{1,3})?(,\d{1,3}(-\d{1,3})?)*)?"


def num_cores() -> int:
    """The CPU cores that this process may use."""
    if sys.platform == "linux":
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def gpu_indices(device: str) -> list[int]:
    """The GPUs of `gpu:2`, `gpu:0,1` or `gpu:0-3`, in ascending order; none for `cpu`."""
    if not device.startswith("gpu"):
        return []
    ranges = re.findall(r"(\d+)(?:-(\d+))?", device) or [("0", "")]
    return sorted(index for first, last in ranges for index in range(int(first), int(last or first) + 1))


def device_name(gpus: Iterable[int]) -> str:
    """`gpu:0,1` for the GPUs 1 and 0."""
    return "gpu:" + ",".join(map(str, sorted(gpus)))
