"""The beginning of one run and its memory: `python -m bench.ours.memory_run FOLDER`.

Request: environment, options, engine (or `auto`), algorithm (as a job has it), device (`cpu` or `gpu`).
"""

import threading
import time
from typing import Any

import psutil

from bench.measure.child import answer


def work(request: dict[str, Any]) -> dict[str, Any]:
    """least_bytes: the estimate; taken_bytes: what the run took until its first updates were made;
    checkpoint_bytes: of the file; engine: which it was; wall_s.

    On a GPU, taken_bytes is the peak in use. On a CPU it is the process's growth after compilation, which
    itself takes more memory than many runs, plus the state, which existed by then.
    """
    from pydantic import TypeAdapter

    from bench.measure.device_memory import peak_bytes
    from core.algorithms.catalog import AlgorithmSpec, least_memory, resolve
    from core.algorithms.events import Phase, Progress
    from core.algorithms.run import make_run
    from core.environments import catalog
    from core.physics.choose import choose, engine_builder

    device = request["device"]
    row = catalog.find(request["environment"])
    options = catalog.parse_options(row, request["options"])
    row = row.under(options)
    settings = resolve(TypeAdapter(AlgorithmSpec).validate_python(request["algorithm"]), row, device)
    engine = request["engine"]
    if engine == "auto":
        engine = choose("auto", device, settings.num_parallel_envs, row.rules_on(device)).name
    began = time.perf_counter()
    environment = catalog.make(row, options, engine_builder(engine))
    run = make_run(environment, settings, seed=0, checkpoint_every_steps=None)
    grown = _Growth()
    for event in run.events():
        if isinstance(event, Phase) and event.name == "compile":
            grown.begin()
        if isinstance(event, Progress):
            break
    checkpoint_bytes = len(run.checkpoint())
    grown_bytes = grown.end() + checkpoint_bytes
    return {
        "least_bytes": least_memory(settings, row, 1).bytes,
        "taken_bytes": peak_bytes() if device == "gpu" else grown_bytes,
        "checkpoint_bytes": checkpoint_bytes,
        "engine": engine,
        "wall_s": time.perf_counter() - began,
    }


class _Growth:
    """The largest growth of the process since the beginning, sampled every 10 ms."""

    def __init__(self) -> None:
        self._process = psutil.Process()
        self._before = self._most = 0
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._look, daemon=True)

    def begin(self) -> None:
        self._before = self._most = self._process.memory_info().rss
        self._thread.start()

    def end(self) -> int:
        self._over.set()
        self._thread.join()
        return self._most - self._before

    def _look(self) -> None:
        while not self._over.wait(0.01):
            self._most = max(self._most, self._process.memory_info().rss)


if __name__ == "__main__":
    answer(work)
