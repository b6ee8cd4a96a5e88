"""One run of the peer, `brax.training.agents.ppo.train`: `python -m bench.peers.train_brax FOLDER`.

Request: environment, engine, settings, seed; epochs (it reports after each); evaluate; device (`cpu`, the
default, or `gpu`); cache (a folder for compiled programs, or null). The engine `mjx_equal` is MJX-JAX with
the solver settings of `native`.
"""

import inspect
import time
from functools import partial
from typing import Any

from bench.measure.cache import keep_compiled
from bench.measure.child import answer

# Brax uses these names with another type or meaning; no bench changes any of them but the first.
_LEFT_ALONE = {
    *("num_evals", "action_repeat", "bootstrap_on_timeout", "clipping_epsilon_value", "desired_kl"),
    *("learning_rate_schedule", "learning_rate_schedule_min_lr", "learning_rate_schedule_max_lr"),
}


def work(request: dict[str, Any]) -> dict[str, Any]:
    """training: [[steps, seconds of training until then], …]; rewards: [[steps, return], …], and
    evaluated_s: for each of them the seconds from the call; wall_s: from the call to its return;
    evaluation_s: of it, evaluating; peak_bytes: the most device memory in use, if the device counts it."""

    from bench.measure.device_memory import peak_bytes
    from bench.measure.turn import Turn

    keep_compiled(request)

    _give_back_what_brax_calls()
    from brax.training.agents.ppo import networks, train
    from brax.training.networks import ACTIVATION

    from bench.peers.brax_environment import BraxEnvironment
    from core.algorithms.catalog import resolve
    from core.algorithms.ppo.spec import PPOSpec
    from core.environments import catalog
    from core.physics.choose import engine_builder

    def builder(name: str) -> Any:
        if name != "mjx_equal":
            return engine_builder(name)
        mjx = engine_builder("mjx")
        # Without MJX's settings for accelerators, which make it less accurate than `native`.
        return lambda model, num_substeps, derived, *, accelerated=None: mjx(model, num_substeps, derived)

    info = catalog.find(request["environment"])
    ours = catalog.make(info, catalog.parse_options(info, {}), builder(request["engine"]))
    settings = resolve(PPOSpec.model_validate(request["settings"]), info, request.get("device", "cpu"))
    training, rewards = list[tuple[int, float]](), list[tuple[int, float]]()
    evaluated_s, evaluation_s = list[float](), 0.0

    def report(step: int, metrics: dict[str, Any]) -> None:
        nonlocal evaluation_s
        if "training/walltime" in metrics:
            training.append((int(step), float(metrics["training/walltime"])))
        if "eval/episode_reward" in metrics:
            rewards.append((int(step), float(metrics["eval/episode_reward"])))
            evaluated_s.append(time.perf_counter() - began)
            evaluation_s = float(metrics["eval/walltime"])

    unequal = [
        name
        for name in (*_LEFT_ALONE - {"num_evals"}, "policy_obs_key", "value_obs_key")
        if getattr(settings, name) != PPOSpec.model_fields[name].default
    ]
    if unequal:
        raise ValueError(f"Brax would run with other settings than ours: {', '.join(unequal)}.")
    known = set(inspect.signature(train.train).parameters) - _LEFT_ALONE
    with Turn():  # Includes compilation: Brax runs its first epoch before it reports anything.
        began = time.perf_counter()
        train.train(
            BraxEnvironment(ours),
            **settings.model_dump(include=known),
            num_evals=request["epochs"] + 1,  # one comes before the first epoch
            run_evals=request["evaluate"],
            network_factory=partial(
                networks.make_ppo_networks,
                policy_hidden_layer_sizes=tuple(settings.policy_hidden_layer_sizes),
                value_hidden_layer_sizes=tuple(settings.value_hidden_layer_sizes),
                activation=ACTIVATION[settings.activation],
            ),
            seed=request["seed"],
            progress_fn=report,
        )
        wall_s = time.perf_counter() - began
    return {
        "training": training,
        "rewards": rewards,
        "evaluated_s": evaluated_s,
        "wall_s": wall_s,
        "evaluation_s": evaluation_s,
        "peak_bytes": peak_bytes(),
    }


def _give_back_what_brax_calls() -> None:
    """Brax 0.14.2 calls a function that JAX has removed; this is what it did."""
    import jax
    import jax.numpy as jnp

    if not hasattr(jax, "device_put_replicated"):
        jax.device_put_replicated = lambda x, to: jax.tree.map(lambda a: jnp.stack([a] * len(to)), x)


if __name__ == "__main__":
    answer(work)
