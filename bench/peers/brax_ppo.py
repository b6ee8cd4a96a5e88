"""The peer, `brax.training.agents.ppo.train`, on one of this project's environments."""

import inspect
from collections.abc import Callable
from functools import partial
from typing import Any

# Brax uses these names with another type or meaning; no bench changes any of them but the first.
_LEFT_ALONE = {
    *("num_evals", "action_repeat", "bootstrap_on_timeout", "clipping_epsilon_value", "desired_kl"),
    *("learning_rate_schedule", "learning_rate_schedule_min_lr", "learning_rate_schedule_max_lr"),
}


def trainer(request: dict[str, Any]) -> Callable[..., Any]:
    """Brax's function with all arguments but how it reports.

    request: environment; engine, `mjx_equal` being MJX-JAX with the solver settings of `native`; settings;
    seed; device (`cpu`, the default, or `gpu`). Raises ValueError if Brax would take the settings otherwise.
    """
    _give_back_what_brax_calls()
    from brax.training.agents.ppo import networks, train
    from brax.training.networks import ACTIVATION

    from bench.peers.brax_environment import BraxEnvironment
    from core.algorithms.catalog import resolve
    from core.algorithms.ppo.spec import PPOSpec
    from core.environments import catalog

    info = catalog.find(request["environment"])
    ours = catalog.make(info, catalog.parse_options(info, {}), _builder(request["engine"]))
    settings = resolve(PPOSpec.model_validate(request["settings"]), info, request.get("device", "cpu"))
    unequal = [
        name
        for name in (*_LEFT_ALONE - {"num_evals"}, "policy_obs_key", "value_obs_key")
        if getattr(settings, name) != PPOSpec.model_fields[name].default
    ]
    if unequal:
        raise ValueError(f"Brax would run with other settings than ours: {', '.join(unequal)}.")
    known = set(inspect.signature(train.train).parameters) - _LEFT_ALONE
    return partial(
        train.train,
        BraxEnvironment(ours),
        **settings.model_dump(include=known),
        network_factory=partial(
            networks.make_ppo_networks,
            policy_hidden_layer_sizes=tuple(settings.policy_hidden_layer_sizes),
            value_hidden_layer_sizes=tuple(settings.value_hidden_layer_sizes),
            activation=ACTIVATION[settings.activation],
        ),
        seed=request["seed"],
    )


def _builder(name: str) -> Any:
    from core.physics.choose import engine_builder

    if name != "mjx_equal":
        return engine_builder(name)
    mjx = engine_builder("mjx")
    # Without MJX's settings for accelerators, which make it less accurate than `native`.
    return lambda model, num_substeps, derived, *, accelerated=None: mjx(model, num_substeps, derived)


def _give_back_what_brax_calls() -> None:
    """Brax 0.14.2 calls a function that JAX has removed; this is what it did."""
    import jax
    import jax.numpy as jnp

    if not hasattr(jax, "device_put_replicated"):
        jax.device_put_replicated = lambda x, to: jax.tree.map(lambda a: jnp.stack([a] * len(to)), x)
