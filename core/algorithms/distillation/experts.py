"""The experts of a run: which of them answers in a state, and the action that it would take there."""

from collections.abc import Mapping, Sequence
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
    """What a state shows: the environment's observation, and the number of the expert that answers, [N]."""

    observation: Any
    expert: jax.Array


@dataclass(frozen=True)
class Experts:
    """policies: deterministic ones. of_row: the number of the expert of each row of the reference's frames;
    None: the first answers everywhere."""

    experts: Sequence[Expert]
    policies: Sequence[TrainedPolicy]
    of_row: np.ndarray | None

    @classmethod
    def of(
        cls, environment: Environment, settings: DistillationSpec, policies: Sequence[TrainedPolicy]
    ) -> "Experts":
        """Raises Rejected where the clips have not one expert each, JobFailed where a policy does not fit."""
        if len(policies) != len(settings.experts):
            raise _misfit(f"The policies of {len(settings.experts)} experts are needed, not {len(policies)}.")
        inner = innermost(environment)
        playback = inner.playback if isinstance(inner, TaskEnv) else None
        numbers = settings.num_of_expert(() if playback is None else playback.frames.names)
        of_row = None if playback is None else np.repeat(np.array(numbers, np.int32), playback.frames.lengths)
        experts = cls(settings.experts, policies, of_row)
        for number, (expert, policy) in enumerate(zip(settings.experts, policies, strict=True)):
            network = network_in(policy.parameters)
            sees = experts._part(number, jax.tree.map(np.zeros, environment.observation_size))
            has = (network.observation_size, network.action_size, network.action_repeat)
            if has != (len(sees), environment.action_size, 1):
                raise _misfit(
                    f"The policy of job {expert.job} sees {has[0]} numbers, gives {has[1]} and holds an "
                    f"action for {has[2]} steps; here it would see {len(sees)}, give "
                    f"{environment.action_size}, and act in each step."
                )
        return experts

    @property
    def parameters(self) -> tuple[Any, ...]:
        """Those of `actions`: arguments of a program, which other experts of the same sizes do not change."""
        return tuple(replace(policy.parameters, value={}) for policy in self.policies)

    def seen(self, state: State) -> Seen:
        """What states [N, ...] show."""
        if self.of_row is None:
            return Seen(state.obs, jnp.zeros(state.done.shape, jnp.int32))
        return Seen(state.obs, jnp.asarray(self.of_row)[state.info[FRAME]])

    def actions(self, parameters: Sequence[Any], seen: Seen) -> jax.Array:
        """The modes of the experts' distributions, [N, action_size]. All experts are asked everywhere."""
        unused = jax.random.key(0)
        answers = [
            policy.answer(params, self._given(number, params, seen.observation), unused)
            for number, (policy, params) in enumerate(zip(self.policies, parameters, strict=True))
            if policy.answer is not None
        ]
        return jnp.take_along_axis(jnp.stack(answers), seen.expert[None, :, None], axis=0)[0]

    def _given(self, number: int, params: Any, observation: Any) -> Any:
        """What an expert is given of observations: by name, if it was trained with several."""
        part = self._part(number, observation)
        return {params.config.policy_obs_key: part} if isinstance(params.normalizer.mean, Mapping) else part

    def _part(self, number: int, observation: Any) -> Any:
        """The numbers [..., n] of observations that an expert sees."""
        expert = self.experts[number]
        values = observation[expert.sees] if isinstance(observation, Mapping) else observation
        if expert.places is None:
            return values
        return values[..., np.concatenate([start + np.arange(size) for start, size in expert.places])]


def _misfit(detail: str) -> JobFailed:
    return JobFailed(Reason.BAD_CHECKPOINT, detail)
