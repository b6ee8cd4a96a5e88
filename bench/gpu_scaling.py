"""PPO on several GPUs of one host: the humanoid, with a fixed number of worlds and unrolls on each."""

from functools import partial
from typing import Any

from bench.child import run_child
from bench.machine import this_machine
from bench.result import Figure, Options, Result, at_least
from bench.training import rate
from core.algorithms.ppo.spec import PPOSpec, resolve
from core.environments import catalog
from core.physics.availability import choose
from worker.device import visible_gpus

_ENVIRONMENT = "humanoid"
_TARGETS = {2: 1.8, 4: 3.4}
_UPDATES = 12
_TIMEOUT_S = 240.0


def measure(options: Options) -> Result:
    """A dozen updates on 1, 2 and 4 GPUs, as far as there are so many."""
    machine = this_machine()
    numbers = [n for n in (1, 2, 4) if n <= len(visible_gpus())]
    train = partial(run_child, "bench.train_ours", timeout_s=_TIMEOUT_S)
    runs = {n: train(_request(n, options)) for n in numbers}
    rates = {n: rate(run["training"]) for n, run in runs.items()}
    figures = [Figure(name=f"{n} GPU", value=value, unit="training steps/s") for n, value in rates.items()]
    figures += [
        Figure(name=f"{n} GPUs ÷ 1", value=rates[n] / rates[1], unit="×", target=at_least(_TARGETS[n]))
        for n in numbers
        if n in _TARGETS
    ]
    return Result(
        name="gpu_scaling",
        title="PPO on several GPUs of one host, humanoid",
        command="./run bench gpu_scaling",
        quick=options.quick,
        machine=machine,
        figures=figures,
        rows=[{"gpus": n, "wall_s": run["wall_s"], **run["phases"]} for n, run in runs.items()],
        notes=[
            f"{_UPDATES} updates under Brax's settings for its humanoid, num_envs and batch_size times the "
            "number of GPUs; training alone over the second half of the run's reports."
        ],
    )


def _request(devices: int, options: Options) -> dict[str, Any]:
    tuned = resolve(PPOSpec(), catalog.find(_ENVIRONMENT), "gpu")
    updates = 4 if options.quick else _UPDATES
    settings = {
        "num_envs": tuned.num_envs * devices,
        "batch_size": tuned.batch_size * devices,
        "num_timesteps": updates * tuned.env_steps_per_update * devices,
        "num_evals": 0,
    }
    return {
        "environment": _ENVIRONMENT,
        "engine": choose("auto", "gpu", _ENVIRONMENT, tuned.num_envs).name,
        "device": "gpu",
        "devices": devices,
        "settings": settings,
        "seed": 0,
        "cache": None,
        "checkpoint_every_steps": None,
    }
