"""The last states of the first body that an engine lost in a run.

An update keeps the positions, velocities and actions of all its steps, few numbers beside the observations
that it keeps anyway, and returns those of one body. No step is simulated again, because an engine on a GPU
need not repeat it bit for bit. So there are as many states as the update has steps since the episode's start,
and at most MOST_STATES.
"""

from dataclasses import replace
from typing import cast

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from core.environments.environment import State
from core.environments.rollout import TARGET

MOST_STATES = 100


@struct.dataclass
class Steps:
    """T steps in N environments, [T, N, ...]; of one body, [T, ...].

    numbers: side by side in one array, which costs a GPU one kernel a step; six arrays took 2 % of the ant's
    update more. sizes: of positions, velocities, actions and targets in it.
    """

    numbers: jax.Array
    sizes: tuple[int, int, int, int] = struct.field(pytree_node=False)

    @classmethod
    def of(cls, before: State, action: jax.Array, reward: jax.Array, ended: jax.Array) -> "Steps":
        """One step of N environments. before: the states in which they acted. ended: [N], 1 at an end."""
        physics = before.physics
        target = before.info.get(TARGET, action[..., :0])
        rows = (physics.qpos, physics.qvel, action, target)
        numbers = jnp.concatenate([*rows, reward[..., None], ended[..., None]], axis=-1)
        return cls(numbers, cast("tuple[int, int, int, int]", tuple(row.shape[-1] for row in rows)))

    @property
    def qpos(self) -> jax.Array:
        """The positions in which the action was taken."""
        return self._part(0)

    @property
    def qvel(self) -> jax.Array:
        """The velocities in which the action was taken."""
        return self._part(1)

    @property
    def action(self) -> jax.Array:
        return self._part(2)

    @property
    def target(self) -> jax.Array | None:
        """See `rollout.TARGET`; None without one."""
        return self._part(3) if self.sizes[3] else None

    @property
    def reward(self) -> jax.Array:
        return self.numbers[..., -2]

    @property
    def ended(self) -> jax.Array:
        """1 where the step was its episode's last one."""
        return self.numbers[..., -1]

    def _part(self, place: int) -> jax.Array:
        begin = sum(self.sizes[:place])
        return self.numbers[..., begin : begin + self.sizes[place]]


@struct.dataclass
class LostBody:
    """The first body that an update lost, and its last steps; any body's where it lost none.

    found: [] bool. update: [] int32, updates made before. env, time_step: [] int32. steps: the update's last
    MOST_STATES up to this time step; if these are fewer, the first of all.
    """

    found: jax.Array
    update: jax.Array
    env: jax.Array
    time_step: jax.Array
    steps: Steps

    def of_the_episode(self) -> Steps:
        """The steps since the episode's start; the last one's action lost the body. Arrays on the host."""
        num_rows = len(self.steps.ended)
        end = min(int(self.time_step), num_rows - 1) + 1
        before = np.flatnonzero(self.steps.ended[: end - 1] > 0)
        begin = int(before[-1]) + 1 if len(before) else 0
        return jax.tree.map(lambda x: x[begin:end], self.steps)


def first_lost(steps: Steps, lost: jax.Array) -> LostBody:
    """The first body that was lost in an update. lost: [T, N], more than 0 where one was."""
    num_steps, num_envs = lost.shape
    found = jnp.any(lost > 0)
    time_step, env = jnp.divmod(jnp.argmax(lost > 0).astype(jnp.int32), num_envs)
    number = min(num_steps, MOST_STATES)
    first = jnp.clip(time_step - number + 1, 0, num_steps - number)

    # Not by an index: environments may lie on several devices.
    some = jax.lax.dynamic_slice_in_dim(steps.numbers, first, number)
    chosen = (jnp.arange(num_envs) == env)[:, None]
    own = replace(steps, numbers=jnp.sum(jnp.where(chosen, some, 0), axis=1))
    return LostBody(found, jnp.int32(0), env, time_step, own)


def earlier(before: LostBody | None, after: LostBody | None, num_updates: jax.Array) -> LostBody | None:
    """The first that the run lost. after: that of the update that followed `num_updates` [] int32 ones."""
    if before is None or after is None:
        return after
    dated = replace(after, update=num_updates)
    return jax.tree.map(lambda a, b: jnp.where(before.found, a, b), before, dated)
