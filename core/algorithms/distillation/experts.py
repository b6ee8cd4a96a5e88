"""The experts of a run: which of them answers in a state, and the action that it would take there."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from core.algorithms.distillation.spec import DistillationSpec, Expert
from core.algorithms.export.network import network_in
from core.algorithms.trained_policy import TrainedPolicy
from core.environments.environment import Environment, State, innermost
from core.environments.reference.playback import FRAME
from core.environments.task import TaskEnv
from core.errors import JobFailed
from core.reasons import Reason


class Seen(NamedTuple):
    """States as experts see them. observation: the environment's. expert: [N], the number of the expert that
    answers in each state."""

    observation: Any
    expert: jax.Array


@dataclass(frozen=True)
class Experts:
    """The policies that a distillation learns from, and which of them answers where.

    answers: (parameters, observations [N, ...], key) -> actions [N, action_size], of each expert. parameters:
    the first argument of each: arguments of a program, which other experts of the same sizes do not change.
    of_row: the number of the expert that answers in each row of the reference's frames; None: without clips
    there is one expert, which answers everywhere.
    """

    experts: Sequence[Expert]
    answers: Sequence[Callable[[Any, Any, jax.Array], jax.Array]]
    parameters: tuple[Any, ...]
    of_row: np.ndarray | None

    @classmethod
    def of(
        cls, environment: Environment, settings: DistillationSpec, policies: Sequence[TrainedPolicy]
    ) -> "Experts":
        """policies: of the experts in their order, deterministic.

        Raises Rejected where a clip does not have exactly one expert, JobFailed where a policy does not fit.
        """
        if len(policies) != len(settings.experts):
            raise _misfit(f"The policies of {len(settings.experts)} experts are needed, not {len(policies)}.")
        inner = innermost(environment)
        playback = inner.playback if isinstance(inner, TaskEnv) else None
        numbers = settings.num_of_expert(() if playback is None else playback.frames.names)
        of_row = None if playback is None else np.repeat(np.array(numbers, np.int32), playback.frames.lengths)
        answers = [_answer(expert, policy) for expert, policy in zip(settings.experts, policies, strict=True)]
        parameters = tuple(replace(policy.parameters, value={}) for policy in policies)
        experts = cls(settings.experts, answers, parameters, of_row)
        for number, (expert, params) in enumerate(zip(settings.experts, parameters, strict=True)):
            network = network_in(params)
            sees = experts._part(number, jax.tree.map(np.zeros, environment.observation_size))
            has = (network.observation_size, network.action_size, network.action_repeat)
            if has != (len(sees), environment.action_size, 1):
                raise _misfit(
                    f"The policy of job {expert.job} sees {has[0]} numbers, gives {has[1]} and holds an "
                    f"action for {has[2]} steps; here it would see {len(sees)}, give "
                    f"{environment.action_size}, and act in each step."
                )
        return experts

    def seen(self, state: State) -> Seen:
        """What `actions` needs of states [N, ...]."""
        if self.of_row is None:
            return Seen(state.obs, jnp.zeros(state.done.shape, jnp.int32))
        return Seen(state.obs, jnp.asarray(self.of_row)[state.info[FRAME]])

    def actions(self, parameters: Sequence[Any], seen: Seen) -> jax.Array:
        """The actions [N, action_size]: for each state the mode of what the expert that answers would draw.

        parameters: those of the experts. Every expert answers in every state; `seen.expert` chooses.
        """
        unused = jax.random.key(0)  # A deterministic policy draws nothing.
        actions = [
            answer(params, self._given(number, params, seen.observation), unused)
            for number, (answer, params) in enumerate(zip(self.answers, parameters, strict=True))
        ]
        return jnp.take_along_axis(jnp.stack(actions), seen.expert[None, :, None], axis=0)[0]

    def _given(self, number: int, params: Any, observation: Any) -> Any:
        """An expert's own observation: under its name, if the expert was trained with several."""
        part = self._part(number, observation)
        return {params.config.policy_obs_key: part} if isinstance(params.normalizer.mean, Mapping) else part

    def _part(self, number: int, observation: Any) -> Any:
        """The numbers [..., n] of observations that an expert sees."""
        expert = self.experts[number]
        values = observation[expert.sees] if isinstance(observation, Mapping) else observation
        if expert.places is None:
            return values
        return values[..., np.concatenate([start + np.arange(size) for start, size in expert.places])]


def _answer(expert: Expert, policy: TrainedPolicy) -> Callable[[Any, Any, jax.Array], jax.Array]:
    if policy.answer is None:
        raise _misfit(f"The policy of job {expert.job} needs more than an observation: it can be no expert.")
    return policy.answer


def _misfit(detail: str) -> JobFailed:
    return JobFailed(Reason.BAD_CHECKPOINT, detail)
