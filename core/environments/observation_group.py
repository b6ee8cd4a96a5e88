"""Observation terms of one model together: what a policy sees in a step, or its value function."""

from collections.abc import Callable, Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from core.environments.terms import history
from core.environments.terms.binding import bound
from core.environments.terms.locomotion import JointPositions
from core.environments.terms.observations import ObservationTerm
from core.environments.terms.step import ModelIndex, Step
from core.environments.terms.term import whole_steps


class ObservationGroup:
    """name: of the group. control_step_s: seconds between actions. is_exact: without noise, bias and delay,
    as a value function sees the terms.

    width: how many numbers the terms have in a step. size: how many are seen, those of past steps included.
    derived: the fields of the physics that it reads. An environment keeps its biases and delays, and the last
    values of terms with a delay or a history, in `State.info`.
    """

    def __init__(
        self,
        name: str,
        terms: Sequence[ObservationTerm],
        model: ModelIndex,
        control_step_s: float,
        *,
        is_exact: bool,
    ) -> None:
        self._name, self._terms, self._model = name, terms, model
        self._bound = [bound(term, model) for term in terms]
        self._delays = [whole_steps(None if is_exact else term.delay, control_step_s) for term in terms]
        self.width = sum(part.size for part in self._bound)
        self.size = sum(term.history * part.size for term, part in zip(terms, self._bound, strict=True))
        self.derived = frozenset[str]().union(*(part.derived for part in self._bound))
        self.is_noisy = not is_exact and any(term.noise for term in terms)
        self._is_biased = not is_exact and any(term.bias for term in terms)
        self._is_delayed = not is_exact and any(term.delay for term in terms)

    @property
    def is_random(self) -> bool:
        return self.is_noisy or self._is_biased or self._is_delayed

    @property
    def encoder_places(self) -> dict[int, int]:
        """By number of a joint: the place among the biases [width] of that with which its position is
        read."""
        found, start = dict[int, int](), 0
        for term, part in zip(self._terms, self._bound, strict=True):
            if isinstance(term, JointPositions) and term.bias:
                for place, joint in enumerate(self._model.joints(term.joints).tolist(), start):
                    found.setdefault(joint, place)
            start += part.size
        return found

    def bias(self, info: Mapping[str, jax.Array]) -> jax.Array:
        """The episode's biases, [width]; of a group that has some."""
        return info[f"{self._name}_bias"]

    def drawn(self, uniform: Callable[[int], jax.Array]) -> dict[str, jax.Array]:
        """The biases [width] and the delays [terms] of an episode, in control steps, as entries of
        `State.info`. uniform: random numbers in [0, 1), as many as it is told."""
        entries: dict[str, jax.Array] = {}
        if not (self._is_biased or self._is_delayed):
            return entries
        numbers = uniform(self.width + len(self._terms))
        if self._is_biased:
            pairs = zip(self._terms, self._bound, strict=True)
            most = np.concatenate([np.full(part.size, term.bias, np.float32) for term, part in pairs])
            entries[f"{self._name}_bias"] = jnp.asarray(most) * (2.0 * numbers[: self.width] - 1.0)
        if self._is_delayed:
            lowest, several = (
                np.array(numbers, np.int32)
                for numbers in zip(*((steps.start, len(steps)) for steps in self._delays), strict=True)
            )
            more = jnp.floor(numbers[self.width :] * several).astype(jnp.int32)
            entries[f"{self._name}_delays"] = jnp.asarray(lowest) + more
        return entries

    def seen(
        self, step: Step, info: Mapping[str, jax.Array], uniform: jax.Array | None
    ) -> tuple[jax.Array, dict[str, jax.Array]]:
        """The numbers [size], and entries of `State.info` for the next step.

        uniform: [width] random numbers in [0, 1) of a noisy group; None of another.
        """
        seen: list[jax.Array] = []
        entries: dict[str, jax.Array] = {}
        bias, delays = info.get(f"{self._name}_bias"), info.get(f"{self._name}_delays")
        start = 0
        for number, (term, part) in enumerate(zip(self._terms, self._bound, strict=True)):
            here = slice(start, start + part.size)
            start += part.size
            values = term.seen(
                step,
                self._model,
                None if uniform is None else uniform[here],
                None if bias is None else bias[here],
            )
            length = term.history + self._delays[number].stop - 1
            if length > 1:
                entry = f"{self._name}_past_{number}"
                past = info.get(entry)
                if past is None:
                    past = history.begun(values, length, jnp)
                else:
                    past = history.remembered(past, values, jnp)
                entries[entry] = past
                values = history.seen(past, term.history, 0 if delays is None else delays[number])
            seen.append(values)
        return jnp.concatenate(seen), entries
