"""The seam between bodies and the programs that move them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, Protocol

import jax
import mujoco
from flax import struct

# Derived fields that an environment may ask for, with MuJoCo's names. They describe the state that is
# returned (position and velocity stages are recomputed after the last substep), except `qfrc_actuator`,
# which is the force of the last substep: the next one's control is not known yet.
DERIVED_FIELDS = (
    "cinert",
    "cvel",
    "geom_xpos",
    "qfrc_actuator",
    "sensordata",
    "site_xpos",
    "subtree_com",
    "ten_length",
    "xmat",
    "xpos",
    "xquat",
)
# What the engine `warp` adds to them by itself: [] float32, 1 where the step lost contacts or constraint
# rows because its buffers were full. The other engines' worlds come back as NaN, or cannot overflow.
OVERFLOW = "overflow"


@struct.dataclass
class PhysicsState:
    """The integration state of one world, and the fields that its environment reads.

    qpos: [nq], qvel: [nv], act: [na], qacc_warmstart: [nv], time: [] in seconds; all float32.
    derived: the fields the engine was built for, by MuJoCo's names and shapes; and `OVERFLOW` of `warp`.
    """

    qpos: jax.Array
    qvel: jax.Array
    act: jax.Array
    qacc_warmstart: jax.Array
    time: jax.Array
    derived: Mapping[str, jax.Array]


class Engine(Protocol):
    """Moves one world; `jax.vmap` makes it many. Pure: equal arguments give equal results."""

    @property
    def name(self) -> str:
        """`native`, `mjx` or `warp`."""
        ...

    def reset(self, qpos: jax.Array, qvel: jax.Array) -> PhysicsState:
        """The state in time 0 with these positions [nq] and velocities [nv], derived fields computed."""
        ...

    def step(self, state: PhysicsState, ctrl: jax.Array) -> PhysicsState:
        """The state `num_substeps` substeps later under a constant control [nu]."""
        ...


@dataclass(frozen=True)
class SolverSettings:
    """What a body can do with when the solver's cost counts: so many iterations, damping or not.

    implicit_damping: Euler's implicit joint damping, which costs one more factorisation each substep.
    """

    iterations: int
    ls_iterations: int
    implicit_damping: bool
    solver: Literal["newton", "cg"] = "newton"


class EngineBuilder(Protocol):
    """Makes the engine of a run; an environment calls it once, and never learns which engine it got."""

    def __call__(
        self,
        model: mujoco.MjModel,
        num_substeps: int,
        derived: tuple[str, ...],
        *,
        accelerated: SolverSettings | None = None,
    ) -> Engine:
        """An engine that computes these derived fields.

        accelerated: the solver settings for engines on an accelerator (`mjx`, `warp`), where each iteration
        is dear; `native` always keeps the model's own, and so does every engine when it is None.
        """
        ...
