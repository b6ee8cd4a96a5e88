"""The interface between environments and the physics engines that step them."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Literal, Protocol

import jax
import jax.numpy as jnp
import mujoco
from flax import serialization, struct

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
# The engine `warp` always adds this one: [] float32, 1 where the step lost contacts or constraint rows
# because its buffers were full. `compiled` returns infinity for such an environment; the others have room
# for all.
OVERFLOW = "overflow"

# Fields of the model that may differ between environments, by their names in `mujoco.batch`. Their values do
# not change the structure of an engine's model, except `dof_frictionloss`: where the model has none, MJX
# makes no room for any. Constants that MuJoCo derives from them (`CONSTANTS`) are not recomputed: code that
# changes a mass must pass them, too. Those of `GEOMETRY` may differ for boxes that never move, and
# are passed together.
MODEL_FIELDS = (
    "actuator_acc0",
    "actuator_biasprm",
    "actuator_dynprm",
    "actuator_forcerange",
    "actuator_gainprm",
    "actuator_gear",
    "body_inertia",
    "body_invweight0",
    "body_ipos",
    "body_mass",
    "body_pos",
    "body_quat",
    "body_subtreemass",
    "dof_armature",
    "dof_damping",
    "dof_frictionloss",
    "dof_invweight0",
    "geom_aabb",
    "geom_friction",
    "geom_pos",
    "geom_quat",
    "geom_rbound",
    "geom_size",
    "geom_solref",
    "jnt_stiffness",
    "opt.gravity",
    "tendon_invweight0",
)
# What `mj_setConst` derives from masses, their centres, inertias, armatures, gears and the positions of
# bodies.
CONSTANTS = ("actuator_acc0", "body_invweight0", "body_subtreemass", "dof_invweight0", "tendon_invweight0")

ModelFields = Mapping[str, jax.Array]
NOMINAL: ModelFields = {}


@struct.dataclass
class PhysicsState:
    """The integration state of one environment, and the fields that its environment reads.

    qpos: [nq], qvel: [nv], act: [na], qacc_warmstart: [nv], time: [] in seconds; all float32.
    derived: the fields the engine was built for, by MuJoCo's names and shapes; with `warp` also `OVERFLOW`.
    model: those of `MODEL_FIELDS` in which this environment differs from the engine's model, in MuJoCo's
    shapes; float32. A step leaves them as they are.
    exact: what an engine has to carry in MuJoCo's own precision, each number as the sum of three float32
    [..., 3]; `native` does so with the delays' history and with the time at which it is read.
    """

    qpos: jax.Array
    qvel: jax.Array
    act: jax.Array
    qacc_warmstart: jax.Array
    time: jax.Array
    derived: Mapping[str, jax.Array]
    model: ModelFields = field(default_factory=dict[str, jax.Array])
    exact: Mapping[str, jax.Array] = field(default_factory=dict[str, jax.Array])


def overflowed(state: PhysicsState) -> jax.Array:
    """[...] float32: 1 where the step that led to these states lost contacts for lack of room."""
    infinite = jnp.isposinf(state.qpos).all(axis=-1) & (state.qpos.shape[-1] > 0)
    return state.derived.get(OVERFLOW, infinite.astype(jnp.float32))


# A state in which these are empty is stored as before they existed.
_LEFT_OUT_IF_EMPTY = ("model", "exact")


def _to_state_dict(state: PhysicsState) -> dict[str, Any]:
    named = {field.name: getattr(state, field.name) for field in fields(state)}
    return {
        name: serialization.to_state_dict(value)
        for name, value in named.items()
        if name not in _LEFT_OUT_IF_EMPTY or value
    }


def _from_state_dict(target: PhysicsState, stored: dict[str, Any]) -> PhysicsState:
    whole: dict[str, Any] = {**{name: {} for name in _LEFT_OUT_IF_EMPTY}, **stored}
    values: dict[str, Any] = {
        field.name: serialization.from_state_dict(getattr(target, field.name), whole[field.name])
        for field in fields(target)
    }
    return PhysicsState(**values)


serialization.register_serialization_state(PhysicsState, _to_state_dict, _from_state_dict, override=True)


def check_model_fields(chosen: ModelFields) -> None:
    """Raises ValueError for a field that cannot differ between environments."""
    if unknown := sorted(set(chosen) - set(MODEL_FIELDS)):
        raise ValueError(f"Environments cannot differ in {unknown}, only in {MODEL_FIELDS}.")


class Engine(Protocol):
    """Moves one environment; `jax.vmap` makes it many. Pure: equal arguments give equal results."""

    @property
    def name(self) -> str:
        """`native`, `mjx`, `warp` or `compiled`."""
        ...

    @property
    def model(self) -> mujoco.MjModel:
        """The model that is stepped, with this engine's solver settings."""
        ...

    def reset(
        self,
        qpos: jax.Array,
        qvel: jax.Array,
        model: ModelFields = NOMINAL,
        act: jax.Array | None = None,
    ) -> PhysicsState:
        """The state at time 0 with these positions [nq] and velocities [nv], derived fields computed.

        model: the fields in which this environment differs from the engine's model; see PhysicsState.
        act: of the actuators [na]; zeros if None.
        """
        ...

    def step(self, state: PhysicsState, ctrl: jax.Array) -> PhysicsState:
        """The state `num_substeps` substeps later under a constant control [nu]."""
        ...


@dataclass(frozen=True)
class SolverSettings:
    """Solver settings that are enough for a body, for engines on which the solver is expensive.

    implicit_damping: Euler's implicit joint damping, which costs one more factorisation per substep.
    asked: the names of the fields that the job itself gives; every engine takes these as they are.
    compiled: what `compiled` takes in place of all of these, `asked` included; if None, it takes these.
    nconmax: see `mujoco_compiled.put_model`.
    """

    iterations: int
    ls_iterations: int
    implicit_damping: bool
    solver: Literal["newton", "cg"] = "newton"
    asked: frozenset[str] = frozenset()
    compiled: "SolverSettings | None" = None
    nconmax: int | None = None

    @classmethod
    def of_job(
        cls,
        iterations: int | None,
        ls_iterations: int | None,
        *,
        implicit_damping: bool,
        solver: Literal["newton", "cg"] = "newton",
    ) -> "SolverSettings":
        """A job's settings; what it leaves out (None) is 4 iterations, with 8 of line search."""
        chosen = {"solver": solver, "iterations": iterations, "ls_iterations": ls_iterations}
        return cls(
            iterations or 4,
            ls_iterations or 8,
            implicit_damping,
            solver,
            asked=frozenset(name for name, value in chosen.items() if value is not None),
        )


class EngineBuilder(Protocol):
    """Makes the engine of a run; an environment calls it once, and does not know which engine it gets."""

    @property
    def name(self) -> str:
        """The engine's name, for environments of other packages, which step themselves and must know it."""
        ...

    def __call__(
        self,
        model: mujoco.MjModel,
        num_substeps: int,
        derived: tuple[str, ...],
        *,
        accelerated: SolverSettings | None = None,
    ) -> Engine:
        """An engine that computes these derived fields.

        accelerated: the solver settings for the engines on which each iteration is expensive (`mjx`, `warp`,
        `compiled`); `native` keeps the model's own but for what the job asks for, and every engine keeps them
        when it is None.
        """
        ...
