"""Tabular Q-learning (Watkins, 1989): rounds of episodes, several agents at once."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from core.algorithms.algorithm import Failure
from core.algorithms.checkpoint import describe
from core.algorithms.evaluation import EpisodeTotals, evaluation_metrics
from core.algorithms.q_learning.discrete_env import DiscreteEnv, Tabular
from core.algorithms.q_learning.learner import (
    QUANTITIES,
    Hyperparameters,
    Learner,
    TrainingState,
    agent_keys,
)
from core.algorithms.q_learning.policy import FORMAT, of_agent, policy_agent, write_policy
from core.algorithms.q_learning.spec import QLearningSpec
from core.algorithms.sharding import ONE_DEVICE
from core.environments.environment import Environment
from core.errors import Rejected


class QLearning:
    """See `core.algorithms.algorithm.Algorithm`. An update is a round: one episode in each environment.

    The policy is the table of one agent; see `policy.read_policy`. devices: 1.

    Raises Rejected for several devices and settings without a state discretizer or an action set;
    JobFailed("bad_model") where the environment lacks what these need.
    """

    quantities = QUANTITIES
    format = FORMAT
    sharding = ONE_DEVICE
    split_fields = ()

    def __init__(
        self, environment: Environment, settings: QLearningSpec, *, seed: int, devices: int = 1
    ) -> None:
        settings.check_sharing(devices)
        if settings.state_discretizer is None or settings.action_set is None:
            raise Rejected("Q-learning needs a `state_discretizer` and an `action_set`.")
        self.settings = settings
        self.seed = agent_keys(settings.agents, seed)
        self.hyperparameters = Hyperparameters.of(settings)
        self.description = describe(environment, settings)
        self._table = Tabular.of(settings.state_discretizer, settings.action_set, environment)
        self.header = self.description | {
            "num_states": self._table.state_discretizer.num_states,
            "epsilon": self.hyperparameters.epsilon_end.tolist(),
            "policy_agent": settings.policy_agent,
        }
        self.env_steps_per_time_step = settings.num_parallel_envs * settings.decision_steps
        self._learner = Learner(DiscreteEnv(environment, self._table, settings.decision_steps), settings)

    def init(self, seed: jax.Array) -> TrainingState:
        return self._learner.init(seed)

    def update(
        self, state: TrainingState, hyperparameters: Hyperparameters
    ) -> tuple[TrainingState, dict[str, jax.Array], Failure]:
        return self._learner.update(state, hyperparameters)

    def evaluated(self, state: TrainingState) -> jax.Array:
        """All agents' tables."""
        return state.table

    def evaluate(self, evaluated: jax.Array, key: jax.Array, update: jax.Array) -> EpisodeTotals:
        return self._learner.evaluate(evaluated, key, update)

    def training_metrics(
        self, state: TrainingState, sums: Mapping[str, Any], num_updates: int
    ) -> dict[str, float]:
        settings = self.settings
        values = {name: value / num_updates for name, value in sums.items()} | _of_the_tables(state)
        episodes = {
            "training/episodes": float(int(state.num_updates) * settings.num_envs),
            "training/num_episodes": float(settings.num_updates * settings.num_envs),
        }
        return episodes | _named("training", values, self._policy_agent(state))

    def after_evaluation(
        self, state: TrainingState, totals: EpisodeTotals
    ) -> tuple[TrainingState, dict[str, float]]:
        """The state notes each agent's return: it decides which table is the policy."""
        returns: NDArray[np.float32] = np.asarray(totals.metrics["reward"]).mean(axis=1)
        state = replace(state, eval_return=jnp.asarray(returns))
        best = self._policy_agent(state)
        own: EpisodeTotals = jax.tree.map(lambda x: x[best], totals)
        metrics = evaluation_metrics(own, self.settings.decision_steps)
        return state, metrics | _named("eval", {"episode_reward": returns}, best)

    def policy(self, state: TrainingState) -> bytes:
        """The table of the agent that is the policy."""
        table, visits = np.asarray(state.table), np.asarray(state.visits)
        return write_policy(of_agent(self._policy_agent(state), table, visits, self.header))

    def tables(self, state: TrainingState) -> Mapping[str, NDArray[Any]]:
        """All agents' tables and visits, [agents, rows, columns]."""
        names = {
            "state_names": self._table.state_discretizer.names,
            "action_names": self._table.action_set.names,
        }
        return {
            "q_table": np.asarray(state.table),
            "visits": np.asarray(state.visits),
            **{name: np.array(texts) for name, texts in names.items() if texts},
        }

    def _policy_agent(self, state: TrainingState) -> int:
        return policy_agent(np.asarray(state.eval_return), self.settings.policy_agent)


def _of_the_tables(state: TrainingState) -> dict[str, Any]:
    """[agents] each."""
    table, visits = np.asarray(state.table), np.asarray(state.visits)
    return {
        "q_max": table.max(axis=(1, 2)),
        "visits": visits.sum(axis=(1, 2)),
        "cells_visited": (visits > 0).mean(axis=(1, 2)),
    }


def _named(group: str, values: Mapping[str, Any], chosen: int) -> dict[str, float]:
    """Values [agents] as metrics: the policy's agent's by their names, and each agent's where there are
    several."""
    own = {f"{group}/{name}": float(value[chosen]) for name, value in values.items()}
    agents = len(next(iter(values.values())))
    if agents == 1:
        return own
    return own | {
        f"{group}/agent_{agent}/{name}": float(value[agent])
        for name, value in values.items()
        for agent in range(agents)
    }
