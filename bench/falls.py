"""PPO on one environment, and when the episodes of what it learned end.

`python -m bench.falls FOLDER` reads FOLDER/request.json as `bench.train_environment` does, for example
`{"environment": "ant", "device": "cpu", "settings": {"discounting": 0.985}}`, and writes FOLDER/answer.json.
"""

from typing import Any

from bench.measure.child import answer
from bench.train_environment import begin

# Episodes that are looked at, and the steps before which an end is counted: for the ant 1 s, 2, 10 and 50 s.
_NUM_EPISODES, _WITHIN = 256, (20, 40, 200, 1000)


def falls(request: dict[str, Any]) -> dict[str, Any]:
    """ended_within: by number of steps, the share of episodes that ended sooner. steps, return: their
    means; speed: m/s, along x."""
    import jax
    import numpy as np

    from core.algorithms.evaluation import run_episodes
    from core.algorithms.policy import load_policy
    from core.environments.environment import State

    began = begin(request)
    for _ in began.run.events():
        pass
    policy = load_policy(began.run.policy(), "ppo", is_checkpoint=False)
    acting = policy.acting(began.environment)
    state = jax.eval_shape(began.environment.reset, jax.random.key(0))

    def act(observations: Any, key: jax.Array) -> tuple[jax.Array, dict[str, Any]]:
        def one(observation: Any) -> jax.Array:
            seen: State = state.replace(obs=observation)
            return acting.act(policy.parameters, seen, key)

        return jax.vmap(one)(observations), {}

    def episodes(key: jax.Array) -> Any:
        most = max(_WITHIN)
        return run_episodes(acting.environment, act, key, num_envs=_NUM_EPISODES, episode_length=most)

    totals = jax.device_get(jax.jit(episodes)(jax.random.key(1_000 + request.get("seed", 0))))
    steps = totals.length
    return {
        "ended_within": {str(number): float(np.mean(steps < number)) for number in _WITHIN},
        "steps": float(np.mean(steps)),
        "return": float(np.mean(totals.metrics["reward"])),
        "speed": float(totals.metrics["x_velocity"].sum() / steps.sum()),
    }


if __name__ == "__main__":
    answer(falls)
