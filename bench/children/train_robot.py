"""One training of a robot that walks by command, and its battery.

Request: robot, options; settings (of PPO; what they leave out is tuned); seed; device (`cpu` or `gpu`);
cache, a folder for compiled programs; battery, as a job has it; keep, a file for the policy, or null.
"""

import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from bench.child import answer
from bench.children.train_ours import engine_of, keep_compiled
from core.start_up import start_lean


def work(request: dict[str, Any]) -> dict[str, Any]:
    """built_at, policy_at, tested_at: the hours when the environment was built, the policy was trained, and
    the battery was over. training: [[steps, seconds of training until then], …]; steps; engine; battery."""
    start_lean()  # As a job does.
    from core.algorithms.battery.run import Battery
    from core.algorithms.battery.spec import BatterySpec
    from core.algorithms.events import Phase, TrainingProgress
    from core.algorithms.run import make_run
    from core.algorithms.trained_policy import load_policy
    from core.environments import catalog
    from core.jobs.resolved import resolve_job
    from core.jobs.spec import TrainSpec
    from core.physics.choose import engine_builder

    body = {"id": request["robot"], "options": request["options"]}
    settings = {"kind": "ppo", **request["settings"]}
    job = resolve_job(TrainSpec.model_validate({"environment": body, "algorithm": settings}))
    ppo = job.settings_on(request["device"])
    engine = engine_of("auto", job.info, request["device"], ppo.num_parallel_envs)
    keep_compiled(request["cache"], engine)
    environment = catalog.make(job.info, job.options, engine_builder(engine))
    told: dict[str, Any] = {"engine": engine, "training": [], "built_at": time.time()}
    run = make_run(environment, ppo, seed=request["seed"], checkpoint_every_steps=None)

    def compiled(content: bytes) -> Battery:
        return Battery(
            lambda options: catalog.make(job.info, options, engine_builder("native")),
            job.options,
            load_policy(content, "ppo", is_checkpoint=False),
            BatterySpec.model_validate(request["battery"]),
        )

    battery = None
    with ThreadPoolExecutor(1) as pool:
        for event in run.events():
            if isinstance(event, Phase) and event.name == "compile" and request["device"] == "gpu":
                battery = pool.submit(compiled, run.policy())  # As a job does: the processor is idle.
            if isinstance(event, TrainingProgress):
                told["training"].append((event.step, event.metrics["training/walltime"]))
        content = run.policy()
        told |= {"steps": run.step, "policy_at": time.time()}
    if request["keep"] is not None:
        Path(request["keep"]).write_bytes(content)
    ready = compiled(content) if battery is None else battery.result()
    parameters = load_policy(content, "ppo", is_checkpoint=False).parameters
    result = ready.run(parameters, seed=request["seed"])
    told["battery"] = result.model_dump(mode="json")
    return {**told, "tested_at": time.time()}


if __name__ == "__main__":
    answer(work)
