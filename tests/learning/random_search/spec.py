"""Hyperparameters of random search, an algorithm that only tests know."""

from typing import Literal

from pydantic import Field

from core.algorithms.spec import BaseSpec


class RandomSearchSpec(BaseSpec):
    """Augmented random search, version 1 (Mania et al., 2018, arXiv:1803.07055, algorithm 1)."""

    kind: Literal["random_search"] = "random_search"
    num_timesteps: int = Field(default=1_000, ge=1, le=10**12)
    num_directions: int = Field(default=8, ge=1, le=2**16)
    episode_length: int = Field(default=8, ge=1, le=10**6)
    learning_rate: float = Field(default=0.1, ge=0, le=10)
    noise: float = Field(default=0.1, gt=0, le=10)
    num_evals: int = Field(default=1, ge=0, le=10_000)
    num_eval_envs: int = Field(default=4, ge=1, le=2**16)

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
