"""Jobs that share a GPU: how much of its memory each may take, and which jobs take as much. Pure.

What a training takes is measured while it runs, and kept for jobs like it. Of a card's memory, a reserve is
for what no job is asked about: CUDA's context, kernels and libraries of each process.
"""

import hashlib
import json

from core.jobs.resolved import resolve_job
from core.jobs.spec import TrainSpec

GIB = 2**30
RESERVE_BYTES = GIB
# What was measured fits into more than it: memory becomes fragmented.
_MARGIN = 1.25
# Libraries fail in a smaller one.
_LEAST_BYTES = GIB // 2
# Settings without a part in memory, besides numbers with a fraction such as a learning rate.
_OF_NO_SIZE = {"kind", "num_timesteps"}


def alike(spec: TrainSpec) -> str:
    """Equal for trainings that take about as much memory on a GPU: of one environment with the same options,
    engine and randomized fields, one algorithm with the same whole numbers, networks and choices, and as many
    seeds and devices. Raises Rejected for a specification that this version refuses."""
    job = resolve_job(spec)
    settings = job.settings_on("gpu")
    sizes = {
        name: value
        for name, value in settings.model_dump(mode="json").items()
        if name not in _OF_NO_SIZE and not isinstance(value, float)
    }
    parts = {
        "options": job.options.model_dump(mode="json"),
        "physics": spec.physics,
        "randomized": sorted({name for rule in spec.randomization for name in rule.fields}),
        "settings": sizes,
        "seeds": len(spec.seeds or [spec.seed]),
        "devices": spec.resources.num_devices,
    }
    digest = hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()
    return f"{spec.environment.id}/{settings.algorithm()}/{digest[:16]}"


def share_for(peak_bytes: int) -> int:
    """The bytes of a GPU for a job like one that took so many at most."""
    return max(_LEAST_BYTES, int(_MARGIN * peak_bytes))


def shared_bytes(memory_bytes: int, seats: int) -> int:
    """What of a GPU's memory as many jobs can have together."""
    return max(0, memory_bytes - seats * RESERVE_BYTES)
