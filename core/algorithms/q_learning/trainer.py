"""A Q-learning run: rounds of episodes, several agents at once."""

import time
from collections.abc import Generator, Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from core.algorithms.checkpoint import describe
from core.algorithms.evaluation import EpisodeTotals, evaluation_metrics
from core.algorithms.loop import Loop
from core.algorithms.q_learning.action_sets import num_arms
from core.algorithms.q_learning.compiled_functions import CompiledFunctions, trace
from core.algorithms.q_learning.discrete_env import DiscreteEnv, Tabular
from core.algorithms.q_learning.learner import (
    QUANTITIES,
    Failure,
    Hyperparameters,
    Learner,
    TrainingState,
    agent_keys,
)
from core.algorithms.q_learning.policy import FORMAT, of_agent, policy_agent, write_policy
from core.algorithms.q_learning.spec import QLearningSpec
from core.algorithms.schedule import Schedule
from core.algorithms.trainer import Event, Phase
from core.environments.environment import Environment
from core.errors import JobFailed, Rejected


class QLearningTrainer:
    """One run of Q-learning; see core.algorithms.trainer.Trainer.

    environment: one world, stepped side by side in `settings.num_envs` for each agent. settings: resolved,
    see `core.algorithms.spec.resolve`. checkpoint_every_steps: environment steps, of all worlds, between
    CheckpointReady events, which come after whole rounds; the last is at the end in any case. resume: a
    checkpoint; the run goes on from it, with its random keys (`seed` is not used), under these settings.
    devices: 1. epoch_s: seconds that an epoch aims at; it changes how often Progress comes, and nothing else.

    Raises Rejected for several devices and settings without indexer or mapper; JobFailed("bad_model") where
    the environment has not got what these need, ("bad_checkpoint") when `resume` is damaged or belongs to a
    run of another shape.
    """

    def __init__(  # noqa: PLR0913 - all of them are named
        self,
        environment: Environment,
        settings: QLearningSpec,
        *,
        seed: int,
        checkpoint_every_steps: int | None,
        resume: bytes | None = None,
        devices: int = 1,
        epoch_s: float = 1.0,
    ) -> None:
        settings.check_sharing(devices)
        if settings.indexer is None or settings.mapper is None:
            raise Rejected("Q-learning needs an `indexer` and a `mapper`.")
        table = Tabular.of(settings.indexer, settings.mapper, environment)
        self._settings = settings
        self._keys = agent_keys(settings.agents, seed)
        self._learner = Learner(DiscreteEnv(environment, table, settings.decision_steps), settings)
        self._hyperparameters = Hyperparameters.of(settings)
        self._description = describe(environment, settings)
        self._facts = self._description | {
            "num_arms": num_arms(environment),
            "epsilon": self._hyperparameters.epsilon_end.tolist(),
            "policy_agent": settings.policy_agent,
        }
        self._loop = Loop(
            Schedule(
                settings.num_updates,
                settings.env_steps_per_update,
                settings.num_evals,
                checkpoint_every_steps,
            ),
            epoch_s,
        )
        self._state: TrainingState | None = None
        if resume is not None:
            self._restore(resume)

    @property
    def step(self) -> int:
        """Environment steps taken so far, of all worlds, those before a resumption included."""
        return self._loop.step

    @property
    def total(self) -> int:
        """Environment steps at the end."""
        return self._loop.total

    def events(self) -> Iterator[Event]:
        """Train to the end of the budget.

        Phase trace and compile; then what `Loop.events` says. Raises JobFailed("diverged") at a value that
        is not finite; `checkpoint()` is then the state before the round that brought it.
        """
        programs = yield from self._prepare()
        yield from self._loop.events(partial(self._train, programs), partial(self._evaluate, programs))

    def checkpoint(self) -> bytes:
        """The whole state of the run: equal states give equal bytes. Valid between two events."""
        return FORMAT.pack(self._facts, self._loop.progress, self._begun)

    def policy(self) -> bytes:
        """The table of the agent that is the policy; see `policy.read_policy`."""
        state = self._begun
        table, visits = np.asarray(state.table), np.asarray(state.visits)
        return write_policy(of_agent(self._policy_agent, table, visits, self._facts))

    def tables(self) -> Mapping[str, NDArray[Any]]:
        """All agents' tables and visits, [agents, rows, columns]; valid between two events."""
        state, table = self._begun, self._learner.environment.table
        names = {"state_names": table.indexer.names, "action_names": table.mapper.names}
        return {
            "q_table": np.asarray(state.table),
            "visits": np.asarray(state.visits),
            **{name: np.array(texts) for name, texts in names.items() if texts},
        }

    @property
    def _begun(self) -> TrainingState:
        if self._state is None:
            raise RuntimeError("The run has no state before its first event.")
        return self._state

    @property
    def _policy_agent(self) -> int:
        return policy_agent(np.asarray(self._begun.eval_return), self._settings.policy_agent)

    def _restore(self, content: bytes) -> None:
        template = jax.eval_shape(self._learner.init, self._keys)
        progress, state = FORMAT.unpack(content, self._description, template)
        self._state = jax.tree.map(jnp.asarray, state)
        self._loop.resume(progress)

    def _prepare(self) -> Generator[Event, None, CompiledFunctions]:
        started = time.perf_counter()
        compile_all = trace(self._learner, self._hyperparameters, self._keys)
        traced = time.perf_counter()
        programs = compile_all()
        compiled = time.perf_counter()
        if self._state is None:
            self._state = programs.init(self._keys)
        yield Phase("trace", traced - started)
        yield Phase("compile", compiled - traced)
        return programs

    def _train(self, programs: CompiledFunctions, until: int) -> dict[str, float]:
        """Train up to `until` rounds; the metrics of the epoch."""
        state, sums, failure = programs.epoch(self._begun, self._hyperparameters, np.int32(until))
        self._state = state
        failure = jax.device_get(failure)
        before, self._loop.updates = self._loop.updates, int(state.num_updates)
        if failure.quantities.any():
            raise self._diverged(failure)
        rounds = self._loop.updates - before
        values = {name: value / rounds for name, value in jax.device_get(sums).items()} | self._of_the_table()
        episodes = {
            "training/episodes": float(self._loop.updates * self._settings.num_envs),
            "training/num_episodes": float(self._settings.num_updates * self._settings.num_envs),
        }
        return episodes | _named("training", values, self._policy_agent)

    def _of_the_table(self) -> dict[str, Any]:
        """[agents] each."""
        state = self._begun
        table, visits = np.asarray(state.table), np.asarray(state.visits)
        return {
            "q_max": table.max(axis=(1, 2)),
            "visits": visits.sum(axis=(1, 2)),
            "cells_visited": (visits > 0).mean(axis=(1, 2)),
        }

    def _evaluate(self, programs: CompiledFunctions) -> dict[str, float]:
        state = self._begun
        totals = jax.device_get(programs.evaluate(state.table, state.eval_key, state.num_updates))
        returns = totals.metrics["reward"].mean(axis=1)
        self._state = replace(state, eval_return=jnp.asarray(returns))
        best = self._policy_agent
        own: EpisodeTotals = jax.tree.map(lambda x: x[best], totals)
        metrics = evaluation_metrics(own, self._settings.decision_steps)
        return metrics | _named("eval", {"episode_reward": returns}, best)

    def _diverged(self, failure: Failure) -> JobFailed:
        """What to tell of a failure in the round that follows the present state."""
        settings = self._settings
        quantity = QUANTITIES[int(np.argmax(failure.quantities))]
        within = int(failure.decision) * settings.num_worlds * settings.decision_steps
        step = self.step + min(within, settings.env_steps_per_update)
        return JobFailed(
            "diverged",
            f"The {quantity} became non-finite at environment step {step}; the last good state is that of "
            f"step {self.step}.",
            step=step,
            quantity=quantity,
        )


def _named(group: str, values: Mapping[str, Any], chosen: int) -> dict[str, float]:
    """Values [agents] as metrics: those of the agent that is the policy by their names, and of several agents
    each one's."""
    own = {f"{group}/{name}": float(value[chosen]) for name, value in values.items()}
    agents = len(next(iter(values.values())))
    if agents == 1:
        return own
    return own | {
        f"{group}/agent_{agent}/{name}": float(value[agent])
        for name, value in values.items()
        for agent in range(agents)
    }
