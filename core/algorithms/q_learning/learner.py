"""Tabular Q-learning: the state of a run, one update of it, and its `Algorithm`.

An update is a round: one episode in each environment. Many rounds run in one compiled loop.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from numpy.typing import NDArray

from core.algorithms.algorithm import Failure
from core.algorithms.checkpoint import describe
from core.algorithms.evaluation import EpisodeTotals, clearly_named, evaluation_metrics, run_episodes
from core.algorithms.q_learning import replay as replays
from core.algorithms.q_learning.discrete_env import DiscreteEnv, Tabular
from core.algorithms.q_learning.spec import AgentSpec, QLearningSpec
from core.algorithms.q_learning.table import (
    FORMAT,
    Exploration,
    Transitions,
    decay_length,
    epsilon_greedy,
    greedy,
    learn,
    of_agent,
    policy_agent,
    td_errors,
    write_policy,
)
from core.algorithms.sharding import ONE_DEVICE
from core.environments.environment import Environment, State
from core.environments.wrappers.autoreset import select
from core.environments.wrappers.vectorized import VectorEnv
from core.errors import Rejected
from core.physics.engine import overflowed

# Each round checks these, in the order in which one spoils the next.
QUANTITIES = ("observation", "reward", "table")
# Larger than any number that a key is split into: the first of these are the tables' and the rounds' keys.
_OF_EVALUATIONS = 0x6576616C


@struct.dataclass
class Hyperparameters:
    """The numbers that may change without recompiling. [agents] float32 each, but decay_length []."""

    learning_rate: jax.Array
    discounting: jax.Array
    epsilon_start: jax.Array
    epsilon_end: jax.Array
    decay_length: jax.Array

    @classmethod
    def of(cls, settings: QLearningSpec) -> "Hyperparameters":
        common = {
            "learning_rate": settings.learning_rate,
            "discounting": settings.discounting,
            "epsilon_start": settings.epsilon.start,
            "epsilon_end": settings.epsilon.end,
        }

        def of_each(name: str) -> jax.Array:
            own = [getattr(agent, name) for agent in settings.agents]
            return jnp.array([common[name] if value is None else value for value in own], jnp.float32)

        return cls(
            **{name: of_each(name) for name in common}, decay_length=jnp.float32(decay_length(settings))
        )


@struct.dataclass
class TrainingState:
    """Everything that a run's future depends on, besides its settings.

    It holds no environments, because each round starts fresh ones.
    table: [agents, S, A] float32. visits: [agents, S, A] int32, transitions that each cell has learnt
    from, replayed ones not counted. replay: with [agents] in front; None without. key: [agents, 2], the next
    round's randomness. eval_key: the evaluations', the same throughout. eval_return: [agents], mean return
    in the last evaluation, 0 before the first. num_updates: [] int32, rounds so far.
    """

    table: jax.Array
    visits: jax.Array
    replay: replays.TransitionReplay | None
    key: jax.Array
    eval_key: jax.Array
    eval_return: jax.Array
    num_updates: jax.Array


class _Learning(NamedTuple):
    """The state of one agent from decision to decision."""

    table: jax.Array
    visits: jax.Array
    replay: replays.TransitionReplay | None


@dataclass(frozen=True)
class Learner:
    """The pure functions of a run. environment: the decision process; settings: what fixes shapes."""

    environment: DiscreteEnv
    settings: QLearningSpec

    def init(self, keys: jax.Array) -> TrainingState:
        """The state before the first round; keys: [agents, 2], one for each agent's seed."""
        table_keys, round_keys = jnp.moveaxis(jax.vmap(jax.random.split)(keys), 1, 0)
        table = jax.vmap(self._initial_table)(table_keys)
        size, agents = self.settings.replay_buffer_size, self.settings.num_agents
        one = replays.empty(size) if size else None
        return TrainingState(
            table=table,
            visits=jnp.zeros(table.shape, jnp.int32),
            replay=jax.tree.map(lambda x: jnp.repeat(x[None], agents, axis=0), one),
            key=round_keys,
            eval_key=jax.random.fold_in(keys[0], _OF_EVALUATIONS),
            eval_return=jnp.zeros(agents),
            num_updates=jnp.int32(0),
        )

    def update(
        self, state: TrainingState, hyperparameters: Hyperparameters
    ) -> tuple[TrainingState, dict[str, jax.Array], Failure]:
        """One round: a fresh episode in every environment, learnt from decision by decision.

        An environment whose episode has ended stands still, and nothing is learnt from it.
        """
        settings = self.settings
        next_key, reset_key, act_key = jnp.moveaxis(
            jax.vmap(partial(jax.random.split, num=3))(state.key), 1, 0
        )
        reset_keys = jax.vmap(partial(jax.random.split, num=settings.num_envs))(reset_key)
        envs = VectorEnv(self.environment).reset(reset_keys.reshape(-1, reset_keys.shape[-1]))
        explore = partial(
            Exploration.of(settings).epsilon,
            hyperparameters.epsilon_start,
            hyperparameters.epsilon_end,
            hyperparameters.decay_length,
            state.num_updates,
        )

        def decide(carry: Any, decision: jax.Array) -> tuple[Any, dict[str, jax.Array]]:
            learning, envs, alive = carry
            keys = jax.vmap(jax.random.fold_in, (0, None))(act_key, decision)
            choose_key, replay_key = jnp.moveaxis(jax.vmap(jax.random.split)(keys), 1, 0)
            rows = self._by_agent(envs.obs)
            epsilon = explore(decision)
            choices = jax.vmap(epsilon_greedy)(learning.table, rows, epsilon, choose_key)
            after = self._step(envs, choices.reshape(envs.obs.shape), alive)
            steps = _transitions(rows, choices, after, self._by_agent(after.obs), alive)
            learning, error = jax.vmap(self._learn)(
                learning, steps, hyperparameters.learning_rate, hyperparameters.discounting, replay_key
            )
            seen = self._seen(after, alive) | {"td_error": error, "epsilon": epsilon}
            return (learning, after, alive & (after.done == 0)), seen

        learning = _Learning(state.table, state.visits, state.replay)
        alive = jnp.ones(settings.num_parallel_envs, bool)
        decisions = jnp.arange(settings.decisions_per_episode)
        (learning, envs, alive), seen = jax.lax.scan(decide, (learning, envs, alive), decisions)
        failure = _failure(seen.pop("unseen"), seen["score"], learning.table)
        new = replace(
            state,
            table=learning.table,
            visits=learning.visits,
            replay=learning.replay,
            key=next_key,
            num_updates=state.num_updates + 1,
        )
        return new, self._summarise(seen, alive), failure

    def evaluate(self, table: jax.Array, key: jax.Array, update: jax.Array) -> EpisodeTotals:
        """Totals [agents, num_eval_envs] of episodes without exploration, the same starts for every agent."""
        agents, episodes = self.settings.num_agents, self.settings.num_eval_envs

        def policy(rows: jax.Array, _: jax.Array) -> tuple[jax.Array, tuple[()]]:
            by_agent = rows.reshape(agents, episodes, -1)
            return jax.vmap(greedy)(table, by_agent).reshape(rows.shape), ()

        totals = run_episodes(
            self.environment,
            policy,
            jax.random.fold_in(key, update),
            num_envs=episodes,
            episode_length=self.settings.decisions_per_episode,
            copies=agents,
        )
        return jax.tree.map(lambda x: x.reshape(agents, episodes), totals)

    def _initial_table(self, key: jax.Array) -> jax.Array:
        settings, shape = self.settings, self.environment.table.shape
        match settings.initial_table:
            case "identity":
                return jnp.eye(*shape)
            case "constant":
                return jnp.full(shape, settings.initial_value)
            case "random":
                scale = settings.initial_scale
                noise = jax.random.uniform(key, shape, minval=-scale, maxval=scale)
                return settings.initial_value + noise

    def _by_agent(self, values: jax.Array) -> jax.Array:
        """[agents, num_envs, ...] of [agents * num_envs, ...]."""
        return values.reshape(self.settings.num_agents, self.settings.num_envs, *values.shape[1:])

    def _step(self, envs: State, choices: jax.Array, alive: jax.Array) -> State:
        after = VectorEnv(self.environment).step(envs, choices)
        return select(alive, after, envs)

    def _learn(
        self,
        learning: _Learning,
        steps: Transitions,
        learning_rate: jax.Array,
        discounting: jax.Array,
        key: jax.Array,
    ) -> tuple[_Learning, jax.Array]:
        """One agent after a decision in all of its environments; and the mean size of the TD errors, []."""
        settings = self.settings
        update = partial(learn, learning_rate=learning_rate, compound=settings.world_updates == "compound")
        errors = td_errors(learning.table, steps, discounting)
        table, visits = update(learning.table, steps, errors)
        replay = learning.replay
        if replay is not None and settings.replay is not None:
            replay = replays.add(replay, steps)
            again = replays.draw(replay, key, settings.replay.batch_size)
            table, _ = update(table, again, td_errors(table, again, discounting))
        size = jnp.sum(steps.weight * jnp.abs(errors)) / jnp.maximum(jnp.sum(steps.weight), 1)
        return _Learning(table, learning.visits + visits.astype(jnp.int32), replay), size

    def _seen(self, after: State, alive: jax.Array) -> dict[str, jax.Array]:
        """Means [agents] over an agent's environments of a decision; those that stand still do not count."""
        values = clearly_named(after.metrics) | {
            "physics_overflow": overflowed(after.physics),
            "score": after.reward,
            "alive": jnp.ones_like(after.reward),
        }
        still = {name: jnp.where(alive, value, 0.0) for name, value in values.items()}
        means = {name: jnp.mean(self._by_agent(value), axis=1) for name, value in still.items()}
        return means | {"unseen": jnp.any(after.obs < 0)}

    def _summarise(self, seen: dict[str, jax.Array], alive: jax.Array) -> dict[str, jax.Array]:
        """One round's metrics, [agents]: means over episodes; the environment's are means over decisions."""
        totals = {name: jnp.sum(values, axis=0) for name, values in seen.items()}
        length = totals.pop("alive")
        score = totals.pop("score")
        learning = ("epsilon", "td_error")
        return {name: total / length for name, total in totals.items() if name not in learning} | {
            **{name: jnp.mean(seen[name], axis=0) for name in learning},
            "episode_reward": score,
            "episode_length": length * self.settings.decision_steps,
            "termination_rate": jnp.mean(self._by_agent(1.0 - alive), axis=1),
        }


def agent_keys(agents: list[AgentSpec], seed: int) -> jax.Array:
    """[agents, 2]: each agent's own, by its seed; without one, by the job's plus its number."""
    seeds = [seed + number if agent.seed is None else agent.seed for number, agent in enumerate(agents)]
    return jnp.stack([jax.random.PRNGKey(own % 2**32) for own in seeds])


def _transitions(
    rows: jax.Array, choices: jax.Array, after: State, next_rows: jax.Array, alive: jax.Array
) -> Transitions:
    """[agents, num_envs * num_parts] each, of rows and choices [agents, num_envs, num_parts]."""

    def spread(values: jax.Array) -> jax.Array:
        """One value of each environment for all who read in it."""
        return jnp.broadcast_to(values.astype(jnp.float32).reshape(*rows.shape[:2], 1), rows.shape)

    steps = Transitions(rows, choices, spread(after.reward), next_rows, spread(after.done), spread(alive))
    return jax.tree.map(lambda x: x.reshape(len(rows), -1), steps)


def _failure(unseen: jax.Array, score: jax.Array, table: jax.Array) -> Failure:
    """A time step is a decision. unseen: [decisions] bool, where a row could not be read; score:
    [decisions, agents]."""
    bad_score = ~jnp.all(jnp.isfinite(score), axis=1)
    bad_table = ~jnp.all(jnp.isfinite(table))
    bad = unseen | bad_score
    first = jnp.where(jnp.any(bad), jnp.argmax(bad), len(bad)).astype(jnp.int32)
    return Failure(jnp.stack([jnp.any(unseen), jnp.any(bad_score), bad_table]), first)


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
