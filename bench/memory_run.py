"""The beginning of one run, and what it has of memory: `python -m bench.memory_run ANSWER REQUEST`.

Request: environment, options, engine (or `auto`), algorithm (as a job has it), device (`cpu` or `gpu`).
"""

import resource
import time
from typing import Any

from bench.child import answer


def work(request: dict[str, Any]) -> dict[str, Any]:
    """least_bytes: the estimate; peak_bytes: the most of the device's memory, or of a CPU's process, that was
    in use until two updates were made; checkpoint_bytes: of the file; engine: which it was; wall_s."""
    from pydantic import TypeAdapter

    from bench.device_memory import peak_bytes
    from core.algorithms.catalog import ALGORITHMS, AlgorithmSpec, loaded
    from core.algorithms.spec import resolve
    from core.algorithms.trainer import Progress
    from core.environments import catalog
    from core.physics.choose import choose, engine_builder

    device = request["device"]
    row = catalog.find(request["environment"])
    options = catalog.parse_options(row, request["options"])
    row = row.under(options)
    settings = resolve(TypeAdapter(AlgorithmSpec).validate_python(request["algorithm"]), row, device)
    engine = request["engine"]
    if engine == "auto":
        engine = choose("auto", device, row.id, settings.num_worlds).name
    began = time.perf_counter()
    environment = catalog.make(row, options, engine_builder(engine))
    trainer = loaded(ALGORITHMS[settings.algorithm()].trainer)(
        environment, settings, seed=0, checkpoint_every_steps=None
    )
    updates = 0
    for event in trainer.events():
        updates += isinstance(event, Progress)
        if updates == 2:
            break
    resident = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return {
        "least_bytes": settings.least_memory(row, 1).bytes,
        "peak_bytes": peak_bytes() if device == "gpu" else resident,
        "checkpoint_bytes": len(trainer.checkpoint()),
        "engine": engine,
        "wall_s": time.perf_counter() - began,
    }


if __name__ == "__main__":
    answer(work)
