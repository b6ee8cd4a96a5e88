"""The observation of a rat in a corridor as the task `rodent` has it, for a decoder that was trained there.

In `rodent` the free joint moves the torso; in a corridor it moves a frame beside which the torso stands. The
joints and their order are the same.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from core.environments.dm_control.rodent.model import rodent_model
from core.environments.info import POLICY_GROUP
from core.environments.observation_group import ObservationGroup
from core.environments.terms.describe import root_of
from core.environments.terms.observations import ObservationTerm
from core.environments.terms.rotations import rotated
from core.environments.terms.step import ModelIndex, Step
from core.physics.engine import PhysicsState
from core.physics.model import initial_qpos

# Fields of the physics that are not arrays with a row for each body.
_NOT_OF_BODIES = ("qfrc_actuator",)


class AsRodent:
    """Measures terms of the task `rodent` on a rat in a corridor, in the units and the order of `rodent`.

    model: the rat in its corridor. trunk: the number of its torso among the model's bodies. dt: of a control
    step, in s. size: how many numbers the terms are. derived: the fields of the physics that they read.
    """

    def __init__(
        self, terms: Sequence[ObservationTerm], model: mujoco.MjModel, trunk: int, dt: float
    ) -> None:
        rodent = rodent_model(model.opt.timestep)
        pose = np.asarray(initial_qpos(rodent))
        index = ModelIndex(rodent, root_of(rodent), pose, (), num_actions=rodent.nu)
        self._group = ObservationGroup(POLICY_GROUP, terms, index, dt, is_exact=True)
        self._beside = jnp.asarray(model.body_pos[trunk], jnp.float32)
        self._first_row = trunk - index.root
        self._dt = dt
        self.size, self.derived = self._group.size, self._group.derived

    def __call__(
        self, before: PhysicsState, after: PhysicsState, action: jax.Array, info: Mapping[str, jax.Array]
    ) -> tuple[jax.Array, Mapping[str, jax.Array]]:
        """The terms' numbers [size] after a step, and entries of `State.info` that the next step reads.

        action: [nu].
        """
        was, now = self._moved(before), self._moved(after)
        return self._group.seen(Step(was, now, action, action, self._dt, jnp), info, None)

    def _moved(self, physics: PhysicsState) -> PhysicsState:
        """The physics as if the free joint moved the torso.

        A free joint's linear velocity is along the world's axes, its angular velocity about the body's own.
        """
        turn, linear, angular = physics.qpos[3:7], physics.qvel[:3], physics.qvel[3:6]
        place = physics.qpos[:3] + rotated(turn, self._beside, jnp)
        linear = linear + rotated(turn, jnp.cross(angular, self._beside), jnp)
        derived = {
            name: values if name in _NOT_OF_BODIES else values[self._first_row :]
            for name, values in physics.derived.items()
            if name in self.derived
        }
        qpos, qvel = physics.qpos.at[:3].set(place), physics.qvel.at[:3].set(linear)
        return replace(physics, qpos=qpos, qvel=qvel, derived=derived)
