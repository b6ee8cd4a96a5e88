"""The compiled programs of a run: traced and compiled once, before the first step."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from core.algorithms.evaluation import EpisodeTotals, run_episodes
from core.algorithms.ppo.brax_training import make_inference_fn
from core.algorithms.ppo.failure import Failure
from core.algorithms.ppo.hyperparameters import Hyperparameters
from core.algorithms.ppo.networks import make_networks
from core.algorithms.ppo.sharding import Sharding
from core.algorithms.ppo.update import Learner, TrainingState
from core.environments.wrappers.vectorized import ENVS


@dataclass(frozen=True)
class CompiledFunctions:
    """Functions that can only run, never compile again: other shapes are an error.

    init: the state before the first update, from a seed. epoch: see Learner.epoch; it consumes the state
    it is given. evaluate: totals of the evaluation's episodes, from (normaliser, policy, value), a key and
    an update count.
    """

    init: Callable[[jax.Array], TrainingState]
    epoch: Callable[[TrainingState, Hyperparameters, np.int32], tuple[TrainingState, Any, Failure]]
    evaluate: Callable[[tuple[Any, ...], jax.Array, jax.Array], EpisodeTotals]


def trace(learner: Learner, hyperparameters: Hyperparameters) -> Callable[[], CompiledFunctions]:
    """Trace every program; calling the result compiles them, side by side.

    Evaluations have few environments: the first device makes them, with a copy of the policy.
    """
    seed, count = jax.ShapeDtypeStruct((), jnp.uint32), jax.ShapeDtypeStruct((), jnp.int32)
    state = jax.eval_shape(learner.init, seed)
    params = (state.normalizer, state.params.policy, state.params.value)
    lowered = (
        _init(learner, state).lower(seed),
        _epoch(learner, state).lower(state, hyperparameters, count),
        jax.jit(_evaluate(learner)).lower(params, state.eval_key, count),
    )

    def compile_all() -> CompiledFunctions:
        with ThreadPoolExecutor() as pool:
            init, epoch, evaluate = pool.map(lambda program: program.compile(), lowered)
        return CompiledFunctions(init, epoch, learner.sharding.on_the_first(evaluate))

    return compile_all


def place(sharding: Sharding, state: TrainingState) -> TrainingState:
    """A state's arrays on the devices that share the run."""
    if sharding.mesh is None:
        return jax.tree.map(jnp.asarray, state)
    return jax.device_put(state, _shardings(sharding, state))


def _shardings(sharding: Sharding, state: TrainingState) -> Any:
    """Where each array of a state lies: environments are split, all else is everywhere."""
    everywhere = jax.tree.map(lambda _: sharding.of_axes(), state)
    return replace(everywhere, episodes=jax.tree.map(lambda _: sharding.of_axes(ENVS), state.episodes))


def _init(learner: Learner, state: TrainingState) -> Any:
    if learner.sharding.mesh is None:
        return jax.jit(learner.init)
    return jax.jit(learner.init, out_shardings=_shardings(learner.sharding, state))


def _epoch(learner: Learner, state: TrainingState) -> Any:
    if learner.sharding.mesh is None:
        return jax.jit(learner.epoch, donate_argnums=0)
    shardings, everywhere = _shardings(learner.sharding, state), learner.sharding.of_axes()
    return jax.jit(
        learner.epoch,
        donate_argnums=0,
        in_shardings=(shardings, everywhere, everywhere),
        out_shardings=(shardings, everywhere, everywhere),
    )


def _evaluate(learner: Learner) -> Callable[[tuple[Any, ...], jax.Array, jax.Array], EpisodeTotals]:
    environment, settings = learner.environment, learner.settings

    def evaluate(params: tuple[Any, ...], key: jax.Array, update: jax.Array) -> EpisodeTotals:
        networks = make_networks(environment.observation_size, environment.action_size, settings)
        return run_episodes(
            environment,
            make_inference_fn(networks)(params, deterministic=settings.deterministic_eval),
            jax.random.fold_in(key, update),
            num_envs=settings.num_eval_envs,
            episode_length=settings.actions_per_episode,
        )

    return evaluate
