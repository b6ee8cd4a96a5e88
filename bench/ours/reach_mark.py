"""A training run until the body reaches a mark: `python -m bench.ours.reach_mark FOLDER`.

Request: environment, engine, settings (hyperparameters), seed, device (`cpu` or `gpu`); mark
(bench.measure.marks); cache (a folder for compiled programs, or null); most_s (seconds of training after
which the run ends at its next evaluation; may be left out). A line [steps, value, seconds] of JSON
on the standard output follows each evaluation; its seconds are those of training and evaluating alone.
"""

import json
import math
import time
from typing import Any

from bench.measure.cache import keep_compiled
from bench.measure.child import answer


def work(request: dict[str, Any]) -> dict[str, Any]:
    """curve: [[steps, value of the mark's metric, seconds from the call], …]; reached_s: of them, at the end
    of the first evaluation that reached the mark, if another with other starts did so, too; reached_at: the
    time of that; confirmed: the value of the other; phases: seconds by name; training_s, evaluation_s: until
    then; trained_s: seconds of training until each evaluation; lengths: mean steps of its episodes."""
    from pydantic import TypeAdapter

    from core.algorithms.catalog import AlgorithmSpec, resolve
    from core.algorithms.events import Evaluated, Phase, Progress
    from core.algorithms.run import make_run
    from core.environments import catalog
    from core.physics.choose import engine_builder

    keep_compiled(request)
    mark = request["mark"]
    info = catalog.find(request["environment"])
    environment = catalog.make(info, catalog.parse_options(info, {}), engine_builder(request["engine"]))
    wanted = TypeAdapter[Any](AlgorithmSpec).validate_python(request["settings"])
    settings = resolve(wanted, info, request["device"])
    began, confirming = time.perf_counter(), 0.0
    run = make_run(environment, settings, seed=request["seed"], checkpoint_every_steps=None)
    told: dict[str, Any] = {"curve": [], "reached_s": None, "reached_at": None, "confirmed": None}
    told |= {"phases": {}, "training_s": 0.0, "evaluation_s": 0.0, "trained_s": [], "lengths": []}
    for event in run.events():
        match event:
            case Phase(name=name, seconds=seconds):
                told["phases"][name] = seconds
            case Progress(metrics=metrics):
                told["training_s"] = metrics["training/walltime"]
            case Evaluated(step=step, metrics=metrics):
                reached_at, seconds = time.time(), time.perf_counter() - began - confirming
                told["evaluation_s"] = metrics["eval/walltime"]
                told["curve"].append((step, metrics[mark["metric"]], seconds))
                told["trained_s"].append(told["training_s"])
                told["lengths"].append(metrics["eval/avg_episode_length"])
                at_work = told["training_s"] + told["evaluation_s"]
                print(json.dumps([step, metrics[mark["metric"]], at_work]), flush=True)
                if metrics[mark["metric"]] >= mark["least"]:
                    before = time.perf_counter()
                    again = run.evaluate(1_000)[mark["metric"]]
                    confirming += time.perf_counter() - before
                    if again >= mark["least"]:
                        told.update(reached_s=seconds, reached_at=reached_at, confirmed=again)
                        break
                if told["training_s"] > request.get("most_s", math.inf):
                    break
            case _:
                pass
    return told


if __name__ == "__main__":
    answer(work)
