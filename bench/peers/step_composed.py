"""The corridor as dm_control composes it, under MJX-JAX.

`python -m bench.peers.step_composed FOLDER`. Request: environment options, num_envs, steps (control
steps in a call, one after the other), n_frames, device, cache. The composed model is unchanged except for
two things that MJX refuses: the noslip solver, and sensors that it does not support.
"""

import time
from typing import Any

from bench.measure.child import answer

_CALLS = 2


def work(request: dict[str, Any]) -> dict[str, Any]:
    """rates: control steps per second, call by call; contacts, rows: how many MJX allocates; compile_s: until
    its program is compiled; finite: whether positions stayed finite."""
    import jax
    import jax.numpy as jnp
    from mujoco import mjx

    from bench.measure.turn import Turn
    from core.environments.dm_control.corridor.compose import composed
    from core.environments.dm_control.corridor.info import CorridorOptions

    if request.get("cache"):
        jax.config.update("jax_compilation_cache_dir", request["cache"])
    spec, upright = composed(CorridorOptions.model_validate(request["options"]))
    spec.option.noslip_iterations = 0
    for sensor in list(spec.sensors):
        spec.delete(sensor)
    model = spec.compile()
    on_device, blank = mjx.put_model(model), mjx.make_data(model)
    num_envs, steps, n_frames = request["num_envs"], request["steps"], request["n_frames"]

    def start(key: jax.Array) -> Any:
        noise = jax.random.uniform(key, (model.nq - 7,), minval=-0.01, maxval=0.01)
        return blank.replace(qpos=blank.qpos.at[:7].set(jnp.asarray(upright)).at[7:].add(noise))

    def control_step(data: Any, key: jax.Array) -> tuple[Any, None]:
        ctrl = jax.random.uniform(key, (num_envs, model.nu), minval=-1.0)
        data = data.replace(ctrl=ctrl)
        one = jax.vmap(lambda d: mjx.step(on_device, d))
        return jax.lax.fori_loop(0, n_frames, lambda _, d: one(d), data), None

    roll = jax.jit(lambda data, key: jax.lax.scan(control_step, data, jax.random.split(key, steps))[0])
    data = jax.vmap(start)(jax.random.split(jax.random.PRNGKey(0), num_envs))
    began = time.perf_counter()
    compiled = roll.lower(data, jax.random.PRNGKey(1)).compile()
    compile_s, rates = time.perf_counter() - began, list[float]()
    with Turn():
        data = jax.block_until_ready(compiled(data, jax.random.PRNGKey(1)))
        for call in range(_CALLS):
            began = time.perf_counter()
            data = jax.block_until_ready(compiled(data, jax.random.PRNGKey(2 + call)))
            rates.append(steps * num_envs / (time.perf_counter() - began))
    return {
        "rates": rates,
        "compile_s": compile_s,
        "contacts": int(blank._impl.ncon),
        "rows": int(blank._impl.nefc),
        "finite": bool(jnp.all(jnp.isfinite(data.qpos))),
    }


if __name__ == "__main__":
    answer(work)
