"""PPO on several GPUs of one host: the humanoid, with a fixed number of environments and unrolls on each."""

from typing import Any

from bench.measure import comparison, requests
from bench.measure.comparison import UNIT, rate
from bench.measure.result import Figure, Options, Result, at_least
from bench.measure.runs import Runs, Work
from core.environments.info import Device
from worker.host.device import visible_gpus

_ENVIRONMENT = "humanoid"
_TARGETS = {2: 1.8, 4: 3.4}
_UPDATES = 24
_TIMEOUT_S = 240.0


def measure(options: Options) -> Result:
    """Some updates on 1, 2 and 4 GPUs, as far as the host has them, each number in its own process."""
    device, body = requests.gpu("gpu_scaling", options), requests.body(_ENVIRONMENT, options)
    numbers = [n for n in (1, 2, 4) if n <= max(1, len(visible_gpus()))]
    runs = Runs("gpu_scaling", options)
    runs.make(
        Work(
            str(n),
            "bench.ours.train_ppo",
            _request(device, body, n, options),
            timeout_s=_TIMEOUT_S,
            cache="kernels",
        )
        for n in numbers
    )
    return Result(
        name="gpu_scaling",
        title="PPO on several GPUs of one host, humanoid",
        command="./run bench gpu_scaling",
        quick=options.quick,
        machine=runs.where(),
        figures=[figure for n in numbers for figure in _figures(n, runs)],
        rows=[comparison.row(n, run, gpus=int(n)) for n, run in runs.done.items()],
        notes=[
            f"{_UPDATES} updates under Brax's settings for its humanoid, num_envs and batch_size times the "
            "number of GPUs; training alone over the second half of the run's reports.",
            *runs.notes(),
        ],
        unfinished=runs.left,
    )


def _figures(n: int, runs: Runs) -> list[Figure]:
    """The rate and its ratio to that of one GPU; or why there is none."""
    rates = {name: rate(run["training"]) for name, run in runs.done.items()}
    value, why = rates.get(str(n)), runs.failed.get(str(n))
    if value is None and why is None:
        return []
    figures = [Figure(name=f"{n} GPU{'s' if n > 1 else ''}", value=value, unit=UNIT, missing=why)]
    if n in _TARGETS:
        gain = value / rates["1"] if value and "1" in rates else None
        missing = None if gain else why or "one GPU's rate is not there"
        name = f"{n} GPUs ÷ 1"
        figures.append(Figure(name=name, value=gain, unit="×", target=at_least(_TARGETS[n]), missing=missing))
    return figures


def _request(device: Device, body: str, devices: int, options: Options) -> dict[str, Any]:
    given = requests.settings(device, body, options, num_evals=0)
    one = requests.resolved(device, body, given)
    updates = 4 if options.quick else _UPDATES
    settings = {
        **given,
        "num_envs": one.num_envs * devices,
        "batch_size": one.batch_size * devices,
        "num_timesteps": updates * one.env_steps_per_update * devices,
    }
    engine = requests.engine(device, body, given, quick=options.quick)
    return {**requests.ours(device, body, engine, settings), "devices": devices, "epoch_s": 0.25}
