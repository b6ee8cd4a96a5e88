"""Physics alone of one engine under one body: `python -m bench.ours.run_physics FOLDER`.

The request is that of bench.ours.train_ppo, with physics_s, how many seconds to step physics, and
steps_per_call, the control steps in a compiled call (default 50).
"""

import time
from typing import Any

from bench.measure.child import answer

_POOL = 128  # Fresh starts to choose from, as in training.


def work(request: dict[str, Any]) -> dict[str, Any]:
    """num_envs; physics: control steps per second, call by call, of environments under random actions:
    engine, observation, reward and new starts, but no network."""
    import jax

    from bench.measure.turn import Turn
    from core.algorithms.catalog import resolve
    from core.algorithms.ppo.spec import PPOSpec
    from core.environments import catalog
    from core.environments.wrappers.autoreset import (
        Episodes,
        draw,
        fresh_states,
        start_episodes,
        step_episodes,
    )
    from core.environments.wrappers.vectorized import VectorEnv
    from core.physics.choose import engine_builder

    info = catalog.find(request["environment"])
    environment = catalog.make(info, catalog.parse_options(info, {}), engine_builder(request["engine"]))
    settings = resolve(PPOSpec.model_validate(request["settings"]), info, request["device"])
    envs, num_envs = VectorEnv(environment), settings.num_envs
    steps = request.get("steps_per_call", 50)
    episodes_key, pool_key, key = jax.random.split(jax.random.PRNGKey(request["seed"]), 3)

    @jax.jit
    def start() -> tuple[Episodes, Any]:
        return start_episodes(envs, episodes_key, num_envs), fresh_states(envs, pool_key, _POOL)

    @jax.jit
    def roll(episodes: Episodes, pool: Any, key: jax.Array) -> Episodes:
        def step(episodes: Episodes, key: jax.Array) -> tuple[Episodes, None]:
            action_key, start_key = jax.random.split(key)
            action = jax.random.uniform(action_key, (num_envs, environment.action_size), minval=-1.0)
            fresh = draw(pool, jax.random.randint(start_key, (num_envs,), 0, _POOL))
            after = step_episodes(envs, episodes, action, fresh, episode_length=settings.actions_per_episode)
            return after, None

        return jax.lax.scan(step, episodes, jax.random.split(key, steps))[0]

    episodes, pool = start()
    compiled = roll.lower(episodes, pool, key).compile()
    rates, spent = list[float](), 0.0
    with Turn():
        episodes = jax.block_until_ready(compiled(episodes, pool, key))  # Lets the bodies fall.
        while len(rates) < 2 or spent < request["physics_s"]:
            key, now = jax.random.split(key)
            began = time.perf_counter()
            episodes = jax.block_until_ready(compiled(episodes, pool, now))
            seconds = time.perf_counter() - began
            spent += seconds
            rates.append(steps * num_envs / seconds)
    return {"num_envs": num_envs, "physics": rates}


if __name__ == "__main__":
    answer(work)
