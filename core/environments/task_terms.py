"""The terms of a task on one model: the rewards, ends, metrics and observations that they make of a step."""

from collections.abc import Mapping, Sequence
from functools import reduce

import jax
import jax.numpy as jnp

from core.environments.environment import Observation, ObservationSize
from core.environments.episode_chance import Chance, Purpose
from core.environments.info import CRITIC_GROUP, POLICY_GROUP
from core.environments.observation_group import ObservationGroup
from core.environments.terms.binding import bound
from core.environments.terms.describe import height_of
from core.environments.terms.inventory import Inventory
from core.environments.terms.rewards import Alive, ControlCost, ForwardVelocity
from core.environments.terms.step import ModelIndex, Step
from core.environments.terms.task import TaskOptions, metric_names, observed, reported
from core.environments.terms.terminations import OutsideHeightRange, TerminationTerm
from core.environments.terms.vocabulary import AnyReward

# An episode ends at these shares of the initial height if its task names no terminations.
_LOWEST, _HIGHEST = 0.4, 2.0


class TaskTerms:
    """parts: of the model. control_step_s: seconds between actions.

    policy: what the policy sees. observation_size: of that, or of both groups. derived: the fields of the
    physics that the terms read.
    """

    def __init__(
        self, options: TaskOptions, parts: Inventory, model: ModelIndex, control_step_s: float
    ) -> None:
        paid = options.reward or _default_reward()
        self._names = metric_names(paid)
        self._weights = [term.sign * term.weight for term in paid]
        self._rewards = [bound(term, model) for term in paid]
        ends = _default_ends(parts, model) if options.termination is None else options.termination
        self._ends = [bound(term, model) for term in ends]
        self._metrics = [bound(term, model) for term in reported(options)]
        self.policy = ObservationGroup(POLICY_GROUP, observed(options), model, control_step_s, is_exact=False)
        self.observation_size: ObservationSize = self.policy.size
        self._critic = None
        if options.critic is not None:
            self._critic = ObservationGroup(
                CRITIC_GROUP, options.critic, model, control_step_s, is_exact=True
            )
            self.observation_size = {POLICY_GROUP: self.policy.size, CRITIC_GROUP: self._critic.size}
        groups = [self.policy, *([self._critic] if self._critic else [])]
        reading = (*self._rewards, *self._ends, *self._metrics, *groups)
        self.derived = frozenset[str]().union(*(part.derived for part in reading))

    def rewards(self, step: Step) -> dict[str, jax.Array]:
        """The weighted terms [] by the names of their metrics; costs are negative."""
        return {
            name: weight * term.measure(step)
            for name, weight, term in zip(self._names, self._weights, self._rewards, strict=True)
        }

    def ended(self, step: Step) -> jax.Array:
        """1 where a term ends the episode, otherwise 0; []."""
        return reduce(jnp.maximum, [term.measure(step) for term in self._ends], jnp.zeros(()))

    def metrics(self, step: Step) -> dict[str, jax.Array]:
        return {name: value for term in self._metrics for name, value in term.measure(step).items()}

    def seen(
        self, step: Step, info: Mapping[str, jax.Array], chance: Chance
    ) -> tuple[Observation, dict[str, jax.Array]]:
        """The observation after the step, and entries of `State.info` for the next one."""
        noise = None
        if self.policy.is_noisy:
            noise = chance.uniform(info, self.policy.width, Purpose.NOISE)
        seen, entries = self.policy.seen(step, info, noise)
        if self._critic is None:
            return seen, entries
        by_critic, its_entries = self._critic.seen(step, info, None)
        return {POLICY_GROUP: seen, CRITIC_GROUP: by_critic}, {**entries, **its_entries}


def _default_reward() -> list[AnyReward]:
    return [ForwardVelocity(), Alive(), ControlCost(weight=0.05)]


def _default_ends(parts: Inventory, model: ModelIndex) -> Sequence[TerminationTerm]:
    height = height_of(model.model, model.pose, model.root)
    if not parts.travels or height <= 0:
        return []
    return [OutsideHeightRange(range=(_LOWEST * height, _HIGHEST * height))]
