"""The seam between bodies and the programs that move them."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Literal, Protocol

import jax
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
# What the engine `warp` adds to them by itself: [] float32, 1 where the step lost contacts or constraint
# rows because its buffers were full. The other engines' worlds come back as NaN, or cannot overflow.
OVERFLOW = "overflow"

# Fields of the model that a world may have to itself, with the names that `mujoco.batch` gives them. No
# engine draws another structure from their values, but for `dof_frictionloss`: where the model has none,
# MJX makes no room for any. Constants that MuJoCo derives from them (`CONSTANTS`) are not computed anew:
# whoever changes a mass brings them along.
MODEL_FIELDS = (
    "actuator_acc0",
    "actuator_biasprm",
    "actuator_dynprm",
    "actuator_forcerange",
    "actuator_gainprm",
    "actuator_gear",
    "body_inertia",
    "body_invweight0",
    "body_mass",
    "body_pos",
    "body_quat",
    "body_subtreemass",
    "dof_armature",
    "dof_damping",
    "dof_frictionloss",
    "dof_invweight0",
    "geom_friction",
    "geom_solref",
    "jnt_stiffness",
    "opt.gravity",
    "tendon_invweight0",
)
# What `mj_setConst` derives from masses, inertias, armatures, gears and where bodies are.
CONSTANTS = ("actuator_acc0", "body_invweight0", "body_subtreemass", "dof_invweight0", "tendon_invweight0")

ModelFields = Mapping[str, jax.Array]
NOMINAL: ModelFields = {}


@struct.dataclass
class PhysicsState:
    """The integration state of one world, and the fields that its environment reads.

    qpos: [nq], qvel: [nv], act: [na], qacc_warmstart: [nv], time: [] in seconds; all float32.
    derived: the fields the engine was built for, by MuJoCo's names and shapes; and `OVERFLOW` of `warp`.
    model: of `MODEL_FIELDS` those in which this world differs from the engine's model, in MuJoCo's shapes;
    float32. They stay as they are from step to step, and begin anew with an episode.
    """

    qpos: jax.Array
    qvel: jax.Array
    act: jax.Array
    qacc_warmstart: jax.Array
    time: jax.Array
    derived: Mapping[str, jax.Array]
    model: ModelFields = field(default_factory=dict[str, jax.Array])


def _to_state_dict(state: PhysicsState) -> dict[str, Any]:
    named = {field.name: getattr(state, field.name) for field in fields(state)}
    # Worlds without fields of their own are stored as they were before there were such.
    return {
        name: serialization.to_state_dict(value) for name, value in named.items() if name != "model" or value
    }


def _from_state_dict(target: PhysicsState, stored: dict[str, Any]) -> PhysicsState:
    whole = {"model": {}, **stored}
    values: dict[str, Any] = {
        field.name: serialization.from_state_dict(getattr(target, field.name), whole[field.name])
        for field in fields(target)
    }
    return PhysicsState(**values)


serialization.register_serialization_state(PhysicsState, _to_state_dict, _from_state_dict, override=True)


def check_model_fields(given: ModelFields) -> None:
    """Raises ValueError where a world cannot have such a field to itself."""
    if unknown := sorted(set(given) - set(MODEL_FIELDS)):
        raise ValueError(f"No world can have {unknown} to itself; there are {MODEL_FIELDS}.")


class Engine(Protocol):
    """Moves one world; `jax.vmap` makes it many. Pure: equal arguments give equal results."""

    @property
    def name(self) -> str:
        """`native`, `mjx` or `warp`."""
        ...

    def reset(self, qpos: jax.Array, qvel: jax.Array, model: ModelFields = NOMINAL) -> PhysicsState:
        """The state in time 0 with these positions [nq] and velocities [nv], derived fields computed.

        model: in which fields of the model this world differs from the engine's; see PhysicsState.
        """
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

    @property
    def name(self) -> str:
        """The engine's: for environments of other packages, which step by themselves and must know."""
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

        accelerated: the solver settings for engines on an accelerator (`mjx`, `warp`), where each iteration
        is dear; `native` always keeps the model's own, and so does every engine when it is None.
        """
        ...
