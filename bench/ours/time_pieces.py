"""Times the parts of one PPO update, each compiled by itself.

`python -m bench.ours.time_pieces FOLDER`: the request of bench.ours.train_ppo, with warm_updates,
the number of updates before timing, and repeats, how often each part is timed.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from bench.measure.cache import keep_compiled
from bench.measure.child import answer
from bench.measure.limits import gradient_step
from core.algorithms.catalog import resolve
from core.algorithms.epoch import updates_until
from core.algorithms.experience import Starts, collect, cut_into_unrolls
from core.algorithms.ppo.hyperparameters import Hyperparameters
from core.algorithms.ppo.networks import make_networks
from core.algorithms.ppo.spec import PPOSpec
from core.algorithms.ppo.update import Learner, TrainingState
from core.environments import catalog
from core.environments.mujoco_env import MujocoEnv
from core.environments.wrappers.autoreset import Episodes, draw, fresh_states, step_episodes
from core.environments.wrappers.vectorized import VectorEnv
from core.physics.choose import engine_builder

_UPDATES_PER_EPOCH = 4


def work(request: dict[str, Any]) -> dict[str, Any]:
    """seconds: of each part of an update, repeat by repeat; need, xla: of one gradient step, calculated and
    by XLA's own count; gradient_steps, steps: in an update."""
    keep_compiled(request)
    info = catalog.find(request["environment"])
    settings = resolve(PPOSpec.model_validate(request["settings"]), info, request["device"])
    built: Any = catalog.make(info, catalog.parse_options(info, {}), engine_builder(request["engine"]))
    pieces = Pieces(built, settings, request["repeats"])
    state = pieces.trained(request["seed"], request["warm_updates"])
    return {
        "seconds": pieces.seconds(state),
        "need": pieces.need(),
        "xla": pieces.counted(state),
        "gradient_steps": settings.num_minibatches * settings.num_updates_per_batch,
        "steps": settings.env_steps_per_update,
        "num_envs": settings.num_envs,
    }


@dataclass(frozen=True)
class Pieces:
    """An update of this body under these settings, in parts."""

    body: MujocoEnv
    settings: PPOSpec
    repeats: int

    @property
    def learner(self) -> Learner:
        return Learner(self.body, self.settings)

    def epoch(self, state: TrainingState, hyperparameters: Hyperparameters, until: Any) -> Any:
        """Updates up to the given number, as in a run."""
        return updates_until(self.learner.update, state, hyperparameters, until)

    @property
    def hyperparameters(self) -> Hyperparameters:
        return Hyperparameters.of(self.settings)

    @property
    def envs(self) -> VectorEnv:
        return VectorEnv(self.body)

    def trained(self, seed: int, updates: int) -> TrainingState:
        """The state after a few updates, in which bodies have fallen and started again."""
        state = jax.jit(self.learner.init)(jnp.uint32(seed))
        state, _, failure = jax.jit(self.epoch)(state, self.hyperparameters, np.int32(updates))
        if np.any(failure.quantities):
            raise RuntimeError("The run diverged before it could be timed.")
        return state

    def seconds(self, state: TrainingState) -> dict[str, list[float]]:
        """epoch: an update inside the compiled loop, where it belongs. update: the same alone; update_twice:
        with twice as many passes over its batch, so that the difference is the learning. acting: policy and
        environments; stepping: the environments alone, with the same actions; engine: of them, physics
        alone; policy: the policy alone, on the same observations. xla_epoch, xla_update, xla_update_twice:
        the same without our kernels, where they take the gradient steps."""
        transitions, actions, starts = self._acted(state)
        twice = self.settings.model_copy(
            update={"num_updates_per_batch": 2 * self.settings.num_updates_per_batch}
        )
        until = jnp.int32(int(state.num_updates) + _UPDATES_PER_EPOCH)
        hyperparameters = self.hyperparameters

        def learning(prefix: str = "", *, kernels: bool) -> dict[str, list[float]]:
            learner = replace(self.learner, kernels=kernels)
            epoch = partial(updates_until, learner.update)
            epochs = self._timed(epoch, state, hyperparameters, until)
            update_twice = replace(learner, settings=twice).update
            return {
                f"{prefix}epoch": [seconds / _UPDATES_PER_EPOCH for seconds in epochs],
                f"{prefix}update": self._timed(learner.update, state, hyperparameters),
                f"{prefix}update_twice": self._timed(update_twice, state, hyperparameters),
            }

        return {
            **learning(kernels=True),
            **(learning("xla_", kernels=False) if self.learner.has_kernels else {}),
            "acting": self._timed(self._act, state, starts),
            "stepping": self._timed(self._step, state.episodes, actions, starts),
            "engine": self._timed(self._move, state.episodes.state.physics, actions),
            "policy": self._timed(self._infer, state, transitions.observation),
        }

    def need(self) -> dict[str, float]:
        """The need of one gradient step by calculation."""
        settings, num_obs, num_act = self.settings, int(self.body.observation_size), self.body.action_size
        need = gradient_step(
            [num_obs, *settings.policy_hidden_layer_sizes, 2 * num_act],
            [num_obs, *settings.value_hidden_layer_sizes, 1],
            unrolls=settings.batch_size,
            unroll_length=settings.unroll_length,
            # Observation, raw action, and log-probability, reward, discount and truncation.
            sample_floats=num_obs + num_act + 4,
        )
        return {"flops": need.flops, "bytes": need.bytes}

    def counted(self, state: TrainingState) -> dict[str, float]:
        """XLA's own count for the gradient and Adam's step on one minibatch; empty if it does not count."""
        import optax
        from brax.training.agents.ppo.losses import compute_ppo_loss

        settings, adam = self.settings, optax.adam(1e-3)
        networks = make_networks(self.body.observation_size, self.body.action_size, settings, normalize=False)

        def step(params: Any, optimizer: Any, minibatch: Any, key: jax.Array) -> Any:
            loss = lambda params: compute_ppo_loss(params, state.normalizer, minibatch, key, networks)  # noqa: E731
            gradient, metrics = jax.grad(loss, has_aux=True)(params)
            change, optimizer = adam.update(gradient, optimizer)
            return optax.apply_updates(params, change), optimizer, metrics

        def minibatch(state: TrainingState) -> Any:
            batch = cut_into_unrolls(self._act(state, self._starts(state))[1], settings.unroll_length)
            return jax.tree.map(lambda x: x[: settings.batch_size], batch)

        shapes = jax.eval_shape(minibatch, state)
        compiled = jax.jit(step).lower(state.params, adam.init(state.params), shapes, state.key).compile()
        counted: Any = compiled.cost_analysis() or {}
        counted = counted[0] if isinstance(counted, list) else counted
        memory: Any = compiled.memory_analysis()
        found = {"flops": counted.get("flops"), "bytes": counted.get("bytes accessed")}
        found["temporary_bytes"] = getattr(memory, "temp_size_in_bytes", None)
        return {name: float(value) for name, value in found.items() if value}

    def _acted(self, state: TrainingState) -> tuple[Any, jax.Array, Starts | None]:
        """Transitions [T, N, ...] of one update, the actions [T, N, action_size] taken, and new starts."""
        starts = jax.jit(self._starts)(state)
        transitions = jax.jit(self._act)(state, starts)[1]
        return transitions, jnp.tanh(transitions.extras["policy_extras"]["raw_action"]), starts

    def _starts(self, state: TrainingState) -> Starts | None:
        settings = self.settings
        if settings.returns_to_first_state:
            return None
        shape = (settings.actions_per_update, settings.num_envs)
        return Starts(
            pool=fresh_states(self.envs, state.key, settings.reset_pool_size),
            chosen=jax.random.randint(state.eval_key, shape, 0, settings.reset_pool_size),
        )

    def _policy(self, state: TrainingState) -> Any:
        from brax.training.agents.ppo.networks import make_inference_fn

        normalize = self.settings.normalize_observations
        networks = make_networks(
            self.body.observation_size, self.body.action_size, self.settings, normalize=normalize
        )
        return make_inference_fn(networks)((state.normalizer, state.params.policy, state.params.value))

    def _keys(self, state: TrainingState) -> jax.Array:
        return jax.random.split(state.key, self.settings.actions_per_update)

    def _act(self, state: TrainingState, starts: Starts | None) -> tuple[Episodes, Any]:
        episodes, (transitions, _) = collect(
            self.envs,
            self._policy(state),
            state.episodes,
            self._keys(state),
            episode_length=self.settings.actions_per_episode,
            starts=starts,
        )
        return episodes, transitions

    def _step(self, episodes: Episodes, actions: jax.Array, starts: Starts | None) -> Episodes:
        def step(episodes: Episodes, given: Any) -> tuple[Episodes, None]:
            action, chosen = given
            fresh = None if starts is None else draw(starts.pool, chosen)
            length = self.settings.actions_per_episode
            return step_episodes(self.envs, episodes, action, fresh, episode_length=length), None

        chosen = None if starts is None else starts.chosen
        return jax.lax.scan(step, episodes, (actions, chosen))[0]

    def _move(self, physics: Any, actions: jax.Array) -> Any:
        low, high = jnp.asarray(self.body.model.actuator_ctrlrange, jnp.float32).T
        controls = (low + high) / 2 + actions * (high - low) / 2
        return jax.lax.scan(
            lambda physics, control: (jax.vmap(self.body.engine.step)(physics, control), None),
            physics,
            controls,
        )[0]

    def _infer(self, state: TrainingState, observations: jax.Array) -> Any:
        policy = self._policy(state)
        return jax.lax.scan(
            lambda _, given: (None, policy(*given)[0]), None, (observations, self._keys(state))
        )[1]

    def _timed(self, function: Callable[..., Any], *arguments: Any) -> list[float]:
        """Seconds of each repeat; the program is compiled and run once before."""
        compiled = jax.jit(function)
        jax.block_until_ready(compiled(*arguments))
        found = list[float]()
        for _ in range(self.repeats):
            began = time.perf_counter()
            jax.block_until_ready(compiled(*arguments))
            found.append(time.perf_counter() - began)
        return found


if __name__ == "__main__":
    answer(work)
