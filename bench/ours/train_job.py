"""A whole training process, then its policy on unseen starts: `python -m bench.ours.train_job FOLDER`.

Request: job (as it would be submitted), episodes (on unseen starts, 0: none), cache (a folder for compiled
programs). The job gets what a service would give it, on the CPU; its target is the brittle star's.
"""

import tempfile
import threading
import time
from pathlib import Path
from typing import Any

from bench.measure.cache import keep_compiled
from bench.measure.child import answer

# Far from the seeds of jobs.
_UNSEEN = 1_000_003
_AT_ONCE = 50


def work(request: dict[str, Any]) -> dict[str, Any]:
    """Seconds since the process's begin: `trained_s` to the end of the last episode, `learnt_s` to the
    policy's file, the evaluation included, `ended_s` to its end, the video included; phases: seconds by name;
    engine; steps: environment steps; training_s, steps_per_s: their training. reached: of the episodes
    afterwards, the share in which the target was reached; arrived_s: the mean of what those took;
    mean_return."""
    from core.jobs.spec import JOB_SPEC
    from core.jobs.submission import completed

    spec = completed(JOB_SPEC.validate_python(request["job"]))
    with tempfile.TemporaryDirectory(prefix="gaitway-bench-") as folder:
        told = _trained(spec, Path(folder), request["cache"])
        policy = (Path(folder) / "policy").read_bytes()
    return told | (_shown(spec, policy, request) if request["episodes"] else {})


def _trained(spec: Any, spool: Path, cache: str | None) -> dict[str, Any]:
    """Raises RuntimeError if the job fails."""
    from worker.compile_cache.local import CACHE
    from worker.host.child import TRAINING, TrainingProcess
    from worker.protocol import Advanced, Failed, FileReady, Measured, PhaseEnded, Started, Task

    if cache is not None:
        (spool / CACHE).symlink_to(Path(cache).absolute())
    task = Task(job_id="bench", attempt=1, spec=spec, device="cpu")
    (spool / "task.json").write_text(task.model_dump_json())
    told: dict[str, Any] = {"phases": {}, "failed": None}
    began = time.perf_counter()
    process = TrainingProcess(TRAINING, spool, spool / "data", "cpu", [])
    # Read in parallel to the messages: a full pipe would stop the process.
    lines = list[str]()
    reading = threading.Thread(target=lambda: lines.extend(process.lines()))
    reading.start()
    for message in process.messages():
        seconds = time.perf_counter() - began
        match message:
            case Started(engine=engine):
                told |= {"engine": engine, "started_s": seconds}
            case PhaseEnded(name=name, seconds=took):
                told["phases"][name] = took
            case Measured(values=values) if "training/walltime" in values:
                told["training_s"] = values["training/walltime"]
            case Advanced(step=step, total=total):
                told |= {
                    "steps": step,
                    **({} if "trained_s" in told or step < total else {"trained_s": seconds}),
                }
            case FileReady(role="policy"):
                told["learnt_s"] = seconds
            case Failed(message=text):
                told["failed"] = text
            case _:
                pass
    reading.join()
    told["ended_s"] = time.perf_counter() - began
    if process.poll(60) != 0 or told.pop("failed") is not None:
        raise RuntimeError("\n".join(lines[-20:]))
    return told | {"steps_per_s": told["steps"] / told["training_s"]}


def _shown(spec: Any, policy: bytes, request: dict[str, Any]) -> dict[str, float]:
    import jax
    import numpy as np

    from core.algorithms.policy import load_policy
    from core.environments import catalog
    from core.environments.rollout import Roller
    from core.physics.availability import choose
    from core.physics.choose import engine_builder

    info, options = catalog.resolve(spec.environment.id, spec.environment.options)
    num_episodes = request["episodes"]
    at_once = min(_AT_ONCE, num_episodes)
    engine = choose("auto", "cpu", at_once, info.on_a_cpu, info.cannot_run).name
    keep_compiled({"cache": request["cache"], "engine": engine})
    environment = catalog.make(info, options, engine_builder(engine))
    trained = load_policy(policy, spec.algorithm.algorithm(), is_checkpoint=False)
    acting, act = trained.acting(environment)
    episodes = Roller(acting, act, num_envs=at_once).episodes(
        trained.parameters,
        jax.random.PRNGKey(_UNSEEN),
        num_steps=info.episode_length,
        num_episodes=num_episodes,
    )
    # Only a target that is reached ends an episode of a star.
    rows = [(float(one.reward.sum()), one.terminated, one.num_steps * environment.dt) for one in episodes]
    returns, reached, seconds = (np.array(column, float) for column in zip(*rows, strict=True))
    return {
        "reached": float(reached.mean()),
        "arrived_s": float((seconds * reached).sum() / max(1.0, reached.sum())),
        "mean_return": float(returns.mean()),
    }


if __name__ == "__main__":
    answer(work)
