"""Engines under one body, in turns.

Request: environment; num_envs, by engine; rounds; steps_per_call, the control steps in a compiled loop.
"""

import time
from collections.abc import Callable
from typing import Any

from bench.child import answer


def work(request: dict[str, Any]) -> dict[str, Any]:
    """rates: by engine, control steps per second, round by round."""
    import jax

    steps = request["steps_per_call"]
    loops = dict[str, Callable[[], Any]]()
    for engine, num_envs in request["num_envs"].items():
        loops[engine] = _loop(*_body(request["environment"], engine), num_envs, steps)
        jax.block_until_ready(loops[engine]())
    rates = {engine: list[float]() for engine in loops}
    for _ in range(request["rounds"]):
        for engine, loop in loops.items():
            began = time.perf_counter()
            jax.block_until_ready(loop())
            rates[engine].append(request["num_envs"][engine] * steps / (time.perf_counter() - began))
    return {"rates": rates}


def _body(environment: str, engine: Any) -> tuple[Any, Any, float]:
    """The engine that the environment asks for, its model, and the seconds of a control step."""
    from core.environments import catalog
    from core.physics.choose import engine_builder

    made = list[tuple[Any, Any, float]]()

    def build_and_keep(model: Any, num_substeps: int, derived: tuple[str, ...], **more: Any) -> Any:
        built = engine_builder(engine)(model, num_substeps, derived, **more)
        made.append((built, model, num_substeps * model.opt.timestep))
        return built

    info = catalog.find(environment)
    catalog.make(info, catalog.parse_options(info, {}), build_and_keep)
    return made[0]


def _loop(engine: Any, model: Any, dt: float, num_envs: int, steps: int) -> Callable[[], Any]:
    """Steps all environments from the same states, under controls that change every 5 steps."""
    import jax
    import jax.numpy as jnp

    from core.physics.model import initial_qpos

    keys = jax.random.split(jax.random.key(0), 2)
    limited = model.actuator_ctrllimited.astype(bool)[:, None]
    low, high = jnp.where(limited, model.actuator_ctrlrange, jnp.array([-1.0, 1.0])).T
    move = jax.vmap(engine.step)

    def run(states: Any, num_steps: int, key: jax.Array) -> Any:
        def step(states: Any, number: jax.Array) -> tuple[Any, None]:
            random = jax.random.uniform(jax.random.fold_in(key, number // 5), (num_envs, model.nu))
            return move(states, low + 0.5 * (1.0 + 0.6 * (random - 0.5)) * (high - low)), None

        return jax.lax.scan(step, states, jnp.arange(num_steps))[0]

    qpos = jnp.tile(jnp.asarray(initial_qpos(model), jnp.float32), (num_envs, 1))
    qvel = 0.1 * jax.random.normal(keys[0], (num_envs, model.nv))
    begun = jax.jit(jax.vmap(engine.reset))(qpos, qvel)
    fallen = jax.jit(run, static_argnums=1)(begun, round(1.0 / dt), keys[0])
    timed = jax.jit(run, static_argnums=1)
    return lambda: timed(fallen, steps, keys[1])


if __name__ == "__main__":
    answer(work)
