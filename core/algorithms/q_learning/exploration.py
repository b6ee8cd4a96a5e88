"""How much is tried at random, and when."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from core.algorithms.epsilon import Shape
from core.algorithms.exploration import decayed
from core.algorithms.q_learning.spec import QLearningSpec


@dataclass(frozen=True)
class Exploration:
    """The part of the schedule that is compiled in.

    decisions: of an agent in one round, in all of its environments.
    """

    by_episodes: bool
    shape: Shape
    decisions_per_round: int
    num_envs: int

    @classmethod
    def of(cls, settings: QLearningSpec) -> "Exploration":
        return cls(
            by_episodes=settings.epsilon.decay_episodes is not None,
            shape=settings.epsilon.shape,
            decisions_per_round=settings.num_envs * settings.decisions_per_episode,
            num_envs=settings.num_envs,
        )

    def epsilon(
        self, start: jax.Array, end: jax.Array, length: jax.Array, rounds: jax.Array, decision: jax.Array
    ) -> jax.Array:
        """Epsilon in the decision [] int32 of an episode, after `rounds` whole rounds [] int32.

        From `start` to `end`, in `length` episodes or decisions, and then it stays.
        """
        per_round = self.num_envs if self.by_episodes else self.decisions_per_round
        within = 0 if self.by_episodes else decision * self.num_envs
        # In float32 from the beginning: a long run has more decisions than an int32 counts.
        done = rounds.astype(jnp.float32) * per_round + within
        return decayed(start, end, done / length, self.shape)


def decay_length(settings: QLearningSpec) -> int:
    """In the schedule's own unit: episodes, or an agent's decisions."""
    epsilon = settings.epsilon
    return epsilon.decay_episodes or epsilon.decay_decisions or settings.num_decisions
