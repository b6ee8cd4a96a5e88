"""Hyperparameters of random search, a third algorithm that only tests know."""

from typing import Literal

from core.algorithms.spec import BaseSpec


class RandomSearchSpec(BaseSpec):
    """Augmented random search, version 1 (Mania et al., 2018, arXiv:1803.07055, algorithm 1)."""

    kind: Literal["random_search"] = "random_search"
    num_timesteps: int = 1_000
    num_directions: int = 8
    episode_length: int = 8
    learning_rate: float = 0.1
    noise: float = 0.1
    num_evals: int = 1
    num_eval_envs: int = 4

    @property
    def num_parallel_envs(self) -> int:
        return 2 * self.num_directions

    @property
    def budget(self) -> int:
        return self.num_timesteps

    @property
    def env_steps_per_update(self) -> int:
        return self.num_parallel_envs * self.episode_length

    @property
    def num_updates(self) -> int:
        return -(-self.num_timesteps // self.env_steps_per_update)
