"""PPO on one environment, and when the episodes of what it learned end.

`python -m bench.falls FOLDER` reads FOLDER/request.json as `bench.train_environment` does, for example
`{"environment": "ant", "device": "cpu", "settings": {"discounting": 0.985}}`, and writes FOLDER/answer.json.
"""

from typing import Any

from bench.measure.child import answer
from bench.train_environment import begin

# Episodes that are looked at, and how many of them side by side.
_NUM_EPISODES, _AT_ONCE = 256, 64
# Ends before so many steps are counted: for the ant 1 s, 2, 10 and 50 s.
_WITHIN = (20, 40, 200, 1000)


def falls(request: dict[str, Any]) -> dict[str, Any]:
    """ended_within: by number of steps, the share of episodes that ended sooner. steps, return: their
    means; speed: m/s, along x."""
    import jax
    import numpy as np

    from core.algorithms.policy import load_policy
    from core.environments.rollout import Roller

    begun = begin(request)
    for _ in begun.run.events():
        pass
    policy = load_policy(begun.run.policy(), "ppo", is_checkpoint=False)
    roller = Roller(*policy.acting(begun.environment), num_envs=_AT_ONCE)
    key = jax.random.key(1_000 + request.get("seed", 0))
    episodes = list(
        roller.episodes(policy.parameters, key, num_steps=max(_WITHIN), num_episodes=_NUM_EPISODES)
    )
    steps = np.array([episode.num_steps for episode in episodes])
    travelled = sum(episode.metrics["x_velocity"].sum() for episode in episodes)
    return {
        "ended_within": {str(number): float(np.mean(steps < number)) for number in _WITHIN},
        "steps": float(np.mean(steps)),
        "return": float(np.mean([episode.reward.sum() for episode in episodes])),
        "speed": float(travelled / steps.sum()),
    }


if __name__ == "__main__":
    answer(falls)
