"""The requests of the training benches to their child processes."""

from typing import Any

from bench.measure.result import Options
from core.algorithms.catalog import resolve
from core.algorithms.ppo.spec import PPOSpec
from core.environments import catalog
from core.environments.info import Device
from core.physics.availability import EngineName, choose, is_installed
from worker.host.device import visible_gpus

Settings = dict[str, Any]

# To try out the bench itself: a body that compiles fast, and a small budget.
_QUICK_BODY = "inverted_pendulum"
_QUICK: Settings = {
    "num_envs": 8,
    "batch_size": 8,
    "num_minibatches": 2,
    "num_updates_per_batch": 1,
    "unroll_length": 5,
    "num_eval_envs": 2,
    "episode_length": 20,
}
_QUICK_OFF_POLICY: Settings = {
    "num_timesteps": 5_120,
    "num_evals": 2,
    "num_eval_envs": 2,
    "episode_length": 20,
    "min_replay_size": 128,
}


def gpu(bench: str, options: Options) -> Device:
    """`gpu`; without one, `cpu` if the bench is only tried out. Exits with a sentence otherwise."""
    if visible_gpus():
        return "gpu"
    if options.quick:
        return "cpu"
    raise SystemExit(f"{bench} needs a GPU, and none is visible here. With --quick it shows that it works.")


def body(wanted: str, options: Options) -> str:
    """The environment to train; a small one if the bench is only tried out."""
    return _QUICK_BODY if options.quick else wanted


def off_policy(options: Options, **changed: Any) -> Settings:
    """Changes to the tuned settings of SAC."""
    return {"kind": "sac", **changed, **(_QUICK_OFF_POLICY if options.quick else {})}


def settings(device: Device, environment: str, options: Options, **changed: Any) -> Settings:
    """Changes to the tuned settings of a body, checked so that a wrong one gives a clear sentence."""
    given = {**_QUICK, **changed} if options.quick else changed
    resolved(device, environment, given)
    return given


def resolved(device: Device, environment: str, given: Settings) -> PPOSpec:
    """All hyperparameters after these changes."""
    return resolve(PPOSpec.model_validate(given), catalog.find(environment), device)


def whole_updates(device: Device, environment: str, given: Settings, updates: int) -> Settings:
    """The same settings with a budget of this number of updates."""
    return {**given, "num_timesteps": updates * resolved(device, environment, given).env_steps_per_update}


def equal_budget(device: Device, environment: str, given: Settings, *, epochs: int) -> Settings:
    """The same settings with a budget that both trainers spend exactly.

    Brax rounds each epoch up to whole updates; this project's trainer rounds the whole run.
    """
    spec = resolved(device, environment, given)
    quantum = epochs * spec.env_steps_per_update
    return {**given, "num_timesteps": -(-spec.num_timesteps // quantum) * quantum}


def engine(device: Device, environment: str, given: Settings, *, quick: bool = False) -> EngineName:
    """The engine that `auto` picks under these settings; see `engine_for`."""
    return engine_for(device, environment, resolved(device, environment, given).num_envs, quick=quick)


def engine_for(device: Device, environment: str, num_envs: int, *, quick: bool = False) -> EngineName:
    """The engine that `auto` picks. quick: whether the bench is only tried out.

    Exits with a sentence if a GPU's engine is not installed here: `auto` would take another one, and the
    bench would measure that.
    """
    rules = catalog.find(environment).rules_on(device)
    wanted = next((rule.engine for rule in rules if rule.fits(num_envs, None)), None)
    if device == "gpu" and not quick and wanted is not None and not is_installed(wanted):
        raise SystemExit(
            f"On a GPU, {environment} runs on the engine {wanted!r}, which is not installed here. Install it "
            f"with `uv sync --inexact --extra {wanted}`."
        )
    return choose("auto", device, num_envs, rules).name


def ours(device: Device, environment: str, engine: str, given: Settings, *, seed: int = 0) -> dict[str, Any]:
    """A request for bench.ours.train_ppo."""
    return {
        "environment": environment,
        "engine": engine,
        "device": device,
        "settings": given,
        "seed": seed,
        "checkpoint_every_steps": None,
    }


def brax(  # noqa: PLR0913 - as ours, and how often it reports
    device: Device,
    environment: str,
    engine: str,
    given: Settings,
    *,
    seed: int = 0,
    epochs: int,
    evaluate: bool = True,
) -> dict[str, Any]:
    """A request for bench.peers.train_brax. A learning rate that falls along a line stays: Brax has none."""
    if resolved(device, environment, given).learning_rate_schedule == "LINEAR":
        given = {**given, "learning_rate_schedule": "NONE"}
    request = ours(device, environment, engine, given, seed=seed)
    del request["checkpoint_every_steps"]
    return {**request, "epochs": epochs, "evaluate": evaluate}
