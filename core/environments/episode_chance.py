"""The random parts of an episode: numbers drawn in each step, commands, and events such as pushes."""

import copy
from collections.abc import Mapping, Sequence
from dataclasses import replace
from enum import IntEnum

import jax
import jax.numpy as jnp
import numpy as np

from core.environments.terms.binding import bound
from core.environments.terms.commands import CommandTerm, EventTerm
from core.environments.terms.step import ModelIndex, Step

# Folded into a reset's key.
_OF_THE_EPISODE = 7


class Purpose(IntEnum):
    """The uses of a step's random numbers. A use is folded into their key; that of event n is EVENT + n."""

    COMMAND = 0
    GAIT = 1
    NOISE = 2
    EVENT = 3
    OBSERVATION = 100
    ACTION = 101


class Chance:
    """The random numbers of an episode, from a key and a count of steps that `State.info` keeps.

    is_needed: whether anything draws some. is_left_out: see `left_out`.
    """

    def __init__(self, control_step_s: float, *, is_needed: bool) -> None:
        self._control_step_s, self._is_needed = control_step_s, is_needed
        self.is_left_out = False

    def left_out(self) -> "Chance":
        """The same, with the mean in place of each random number."""
        there = copy.copy(self)
        there.is_left_out = True
        return there

    def begun(self, key: jax.Array) -> dict[str, jax.Array]:
        """Entries of `State.info` at an episode's start. key: of its reset."""
        if not self._is_needed:
            return {}
        own = jax.random.key_data(jax.random.fold_in(key, _OF_THE_EPISODE))
        return {"key": own, "steps": jnp.zeros((), jnp.int32)}

    def stepped(self, info: Mapping[str, jax.Array]) -> dict[str, jax.Array]:
        """Those of the next step."""
        return {"steps": info["steps"] + 1} if self._is_needed else {}

    def uniform(self, info: Mapping[str, jax.Array], number: int, purpose: int) -> jax.Array:
        """Random numbers [number] in [0, 1) of this step, for one purpose."""
        if self.is_left_out:
            return jnp.full(number, 0.5)
        of_the_step = jax.random.fold_in(jax.random.wrap_key_data(info["key"]), info["steps"])
        return jax.random.uniform(jax.random.fold_in(of_the_step, purpose), (number,))

    def is_due(self, info: Mapping[str, jax.Array], every_s: float) -> jax.Array:
        """Whether what happens every so many seconds does in this step, []."""
        return info["steps"] % max(1, round(every_s / self._control_step_s)) == 0


class CommandSampler:
    """When a command is drawn, and what the policy is told of that.

    num_targets: how many numbers are drawn. derived: the fields of the physics that it reads. An environment
    keeps the command of the next step [n] in `State.info`, and what it follows from, if it follows, as
    `target` [num_targets].
    """

    def __init__(self, command: CommandTerm, model: ModelIndex) -> None:
        self._command = command
        random, size = np.zeros(command.num_random), None if command.follows else model.num_commands
        self._draw = bound(command, model, "drawn", random, size=size)
        self.num_targets, self.derived = self._draw.size, self._draw.derived
        self._tell = None
        if command.follows:
            self._tell = bound(command, model, "told", np.zeros(self.num_targets), size=model.num_commands)
            self.derived |= self._tell.derived
        self._given: jax.Array | None = None

    def given(self, command: jax.Array | None) -> "CommandSampler":
        """The sampler that always tells this command [n]; None: what is drawn."""
        there = copy.copy(self)
        there._given = command
        return there

    def begun(self, step: Step, info: Mapping[str, jax.Array], chance: Chance) -> dict[str, jax.Array]:
        """Entries of `State.info` at an episode's start."""
        return self._told(self._drawn(step, info, chance), step)

    def stepped(self, step: Step, info: Mapping[str, jax.Array], chance: Chance) -> dict[str, jax.Array]:
        """Those after a step."""
        before = info["command" if self._tell is None else "target"]
        fresh = self._drawn(step, info, chance)
        return self._told(jnp.where(chance.is_due(info, self._command.every_s), fresh, before), step)

    def _drawn(self, step: Step, info: Mapping[str, jax.Array], chance: Chance) -> jax.Array:
        uniform = chance.uniform(info, self._command.num_random, Purpose.COMMAND)
        return jnp.float32(self._draw.measure(step, uniform))

    def _told(self, drawn: jax.Array, step: Step) -> dict[str, jax.Array]:
        """Entries of `State.info` for a command that was drawn."""
        if self._given is not None:
            return {"command": self._given}
        if self._tell is None:
            return {"command": drawn}
        return {"target": drawn, "command": jnp.float32(self._tell.measure(step, drawn))}


class Events:
    """derived: the fields of the physics that they read."""

    def __init__(self, events: Sequence[EventTerm], model: ModelIndex) -> None:
        self._events, size = events, model.model.nv
        self._drawn = [bound(one, model, "drawn", np.zeros(one.num_random), size=size) for one in events]
        self.derived = frozenset[str]().union(*(event.derived for event in self._drawn))

    def applied(self, step: Step, info: Mapping[str, jax.Array], chance: Chance) -> Step:
        """The step that begins after the events. step: one that has not begun."""
        for number, (event, drawn) in enumerate(zip(self._events, self._drawn, strict=True)):
            uniform = chance.uniform(info, event.num_random, Purpose.EVENT + number)
            change = drawn.measure(step, uniform)
            change = jnp.where(chance.is_due(info, event.every_s), change, 0.0)
            physics = replace(step.after, qvel=step.after.qvel + change)
            step = replace(step, before=physics, after=physics)
        return step
