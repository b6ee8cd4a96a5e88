"""One run of the peer, `brax.training.agents.ppo.train`: `python -m bench.train_brax ANSWER REQUEST`.

Request: environment, engine, settings, seed; epochs (it reports after each); evaluate; device (`cpu`, which
it is without one, or `gpu`); cache (a folder for compiled programs, or null). The engine `mjx_equal` is
MJX-JAX with the solver settings that `native` has.
"""

import time
from functools import partial
from typing import Any

from bench.child import answer

# What `ppo.train` calls by other names, or not at all; and options that the benches leave as they are.
_NOT_BRAX = {
    *("kind", "policy_hidden_layer_sizes", "value_hidden_layer_sizes", "num_evals", "reset_pool_size"),
    *("activation", "policy_obs_key", "value_obs_key", "action_repeat", "bootstrap_on_timeout"),
    *("clipping_epsilon_value", "desired_kl", "learning_rate_schedule"),
    *("learning_rate_schedule_min_lr", "learning_rate_schedule_max_lr"),
}


def work(request: dict[str, Any]) -> dict[str, Any]:
    """training: [[steps, seconds of training until then], …]; wall_s: from the call to its return;
    peak_bytes: the most device memory in use, where the device counts it."""
    import jax
    import jax.numpy as jnp

    from bench.device_memory import peak_bytes

    if request.get("cache"):
        jax.config.update("jax_compilation_cache_dir", request["cache"])

    # Brax 0.14.2 calls a function that JAX has removed; these two lines are what it did.
    if not hasattr(jax, "device_put_replicated"):
        jax.device_put_replicated = lambda x, to: jax.tree.map(lambda a: jnp.stack([a] * len(to)), x)
    from brax.training.agents.ppo import networks, train

    from bench.brax_environment import BraxEnvironment
    from core.algorithms.ppo.spec import PPOSpec, resolve
    from core.environments import catalog
    from core.physics.choose import engine_builder

    def builder(name: str) -> Any:
        if name != "mjx_equal":
            return engine_builder(name)
        mjx = engine_builder("mjx")
        # The settings for accelerators are what makes it less accurate than `native`: leave them out.
        return lambda model, num_substeps, derived, *, accelerated=None: mjx(model, num_substeps, derived)

    info = catalog.find(request["environment"])
    ours = catalog.make(info, catalog.parse_options(info, {}), builder(request["engine"]))
    settings = resolve(PPOSpec.model_validate(request["settings"]), info, request.get("device", "cpu"))
    training, rewards = list[tuple[int, float]](), list[tuple[int, float]]()

    def report(step: int, metrics: dict[str, Any]) -> None:
        if "training/walltime" in metrics:
            training.append((int(step), float(metrics["training/walltime"])))
        if "eval/episode_reward" in metrics:
            rewards.append((int(step), float(metrics["eval/episode_reward"])))

    began = time.perf_counter()
    train.train(
        BraxEnvironment(ours),
        **settings.model_dump(exclude=_NOT_BRAX),
        num_evals=request["epochs"] + 1,  # one comes before the first epoch
        run_evals=request["evaluate"],
        network_factory=partial(
            networks.make_ppo_networks,
            policy_hidden_layer_sizes=tuple(settings.policy_hidden_layer_sizes),
            value_hidden_layer_sizes=tuple(settings.value_hidden_layer_sizes),
        ),
        seed=request["seed"],
        progress_fn=report,
    )
    wall_s = time.perf_counter() - began
    return {"training": training, "rewards": rewards, "wall_s": wall_s, "peak_bytes": peak_bytes()}


if __name__ == "__main__":
    answer(work)
