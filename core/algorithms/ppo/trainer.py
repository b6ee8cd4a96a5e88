"""A PPO run: Brax's networks, loss, normaliser and distributions in a loop of our own."""

import time
from collections.abc import Generator, Iterator, Mapping
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from core.algorithms.evaluation import evaluation_metrics
from core.algorithms.loop import Loop
from core.algorithms.ppo import checkpoint
from core.algorithms.ppo.compiled_functions import CompiledFunctions, place, trace
from core.algorithms.ppo.failure import QUANTITIES, Failure
from core.algorithms.ppo.hyperparameters import Hyperparameters
from core.algorithms.ppo.networks import PolicyConfig, PolicyParams
from core.algorithms.ppo.policy import write_policy
from core.algorithms.ppo.sharding import Sharding
from core.algorithms.ppo.spec import PPOSpec
from core.algorithms.ppo.update import Learner, TrainingState
from core.algorithms.schedule import Schedule
from core.algorithms.trainer import Event, Phase
from core.environments.environment import Environment
from core.environments.wrappers.action_repeat import repeat_action
from core.errors import JobFailed


class PPOTrainer:
    """One run of PPO; see core.algorithms.trainer.Trainer.

    environment: one world, stepped side by side in `settings.num_envs`. settings: resolved, see
    `spec.resolve`. checkpoint_every_steps: environment steps between CheckpointReady events; the last is
    at the end in any case. resume: a checkpoint; the run goes on from it, with its random keys (`seed`
    is not used), under these settings, and on any number of devices. devices: how many of JAX's share the
    run; environments and each minibatch are dealt out in equal parts, and the result is that of one
    device but for rounding. epoch_s: seconds that an epoch aims at; it changes how often Progress comes,
    and nothing else.

    Raises Rejected when the devices cannot have equal parts; JobFailed("bad_checkpoint") when `resume` is
    damaged or belongs to a run of another shape.
    """

    def __init__(  # noqa: PLR0913 - all of them are named
        self,
        environment: Environment,
        settings: PPOSpec,
        *,
        seed: int,
        checkpoint_every_steps: int | None,
        resume: bytes | None = None,
        devices: int = 1,
        epoch_s: float = 1.0,
    ) -> None:
        self._seed = jnp.uint32(seed)
        sharding = Sharding.over(devices, settings)
        self._learner = Learner(repeat_action(environment, settings.action_repeat), settings, sharding)
        self._hyperparameters = jax.device_put(Hyperparameters.of(settings), sharding.of_axes())
        self._description = checkpoint.describe(environment, settings)
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
        """Environment steps taken so far, those before a resumption included."""
        return self._loop.step

    @property
    def total(self) -> int:
        """Environment steps at the end."""
        return self._loop.total

    def events(self) -> Iterator[Event]:
        """Train to the end of the budget, rounded up to whole updates.

        Phase trace and compile; then what `Loop.events` says.
        Raises JobFailed("diverged") at a value that is not finite; `checkpoint()` is then the state
        before the update that brought it.
        """
        programs = yield from self._prepare()
        yield from self._loop.events(partial(self._train, programs), partial(self._evaluate, programs))

    def checkpoint(self) -> bytes:
        """The whole state of the run: equal states give equal bytes. Valid between two events."""
        return checkpoint.pack(self._description, self._loop.progress, self._begun)

    def policy(self) -> bytes:
        """(normaliser, policy, value) in the file that `brax.io.model.load_params` reads."""
        return write_policy(self._params)

    @property
    def _begun(self) -> TrainingState:
        if self._state is None:
            raise RuntimeError("The run has no state before its first event.")
        return self._state

    @property
    def _params(self) -> PolicyParams:
        state = self._begun
        config = PolicyConfig.of(self._learner.settings.model_dump())
        return PolicyParams(state.normalizer, state.params.policy, state.params.value, config)

    def _restore(self, content: bytes) -> None:
        template = jax.eval_shape(self._learner.init, self._seed)
        progress, state = checkpoint.unpack(content, self._description, template)
        self._state = place(self._learner.sharding, state)
        self._loop.resume(progress)

    def _prepare(self) -> Generator[Event, None, CompiledFunctions]:
        started = time.perf_counter()
        compile_all = trace(self._learner, self._hyperparameters)
        traced = time.perf_counter()
        programs = compile_all()
        compiled = time.perf_counter()
        if self._state is None:
            self._state = programs.init(self._seed)
        yield Phase("trace", traced - started)
        yield Phase("compile", compiled - traced)
        return programs

    def _train(self, programs: CompiledFunctions, until: int) -> dict[str, float]:
        """Train up to `until` updates; the metrics of the epoch."""
        state, sums, failure = programs.epoch(self._begun, self._hyperparameters, np.int32(until))
        self._state = state
        failure = jax.device_get(failure)
        before, self._loop.updates = self._loop.updates, int(state.num_updates)
        if failure.quantities.any():
            raise self._diverged(failure)
        return _training_metrics(
            jax.device_get(sums), self._loop.updates - before, self._learner.settings.action_repeat
        )

    def _evaluate(self, programs: CompiledFunctions) -> dict[str, float]:
        totals = programs.evaluate(tuple(self._params), self._begun.eval_key, self._begun.num_updates)
        return evaluation_metrics(jax.device_get(totals), self._learner.settings.action_repeat)

    def _diverged(self, failure: Failure) -> JobFailed:
        """What to tell of a failure in the update that follows the present state."""
        settings = self._learner.settings
        quantity = QUANTITIES[int(np.argmax(failure.quantities))]
        within = min(
            int(failure.time_step) * settings.num_envs * settings.action_repeat, settings.env_steps_per_update
        )
        step = self.step + within
        return JobFailed(
            "diverged",
            f"The {quantity} became non-finite at environment step {step}; the last good state is that of "
            f"step {self.step}.",
            step=step,
            quantity=quantity,
        )


def _training_metrics(sums: Mapping[str, Any], updates: int, action_repeat: int) -> dict[str, float]:
    """An epoch's metrics by Brax's names, from sums over its updates; lengths are in environment steps."""
    values = {name: float(value) for name, value in sums.items()}
    episodes, score, length, falls = (values.pop(name) for name in ("episodes", "score", "length", "falls"))
    metrics = {f"training/{name}": value / updates for name, value in values.items()}
    if episodes:
        metrics["training/episode_reward"] = score / episodes
        metrics["training/episode_length"] = length / episodes * action_repeat
        metrics["training/fall_rate"] = falls / episodes
    return metrics
