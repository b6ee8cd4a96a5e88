"""The state of an environment, with the names of MuJoCo's `mjData`, and what moves it."""

from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import mujoco

from mujoco_compiled.coverage import Uncovered
from mujoco_compiled.model import Model
from mujoco_compiled.smooth.delays import is_of_last_steps, ordered_history

_register = partial(jax.tree_util.register_dataclass, meta_fields=[])


@dataclass(frozen=True, eq=False)
class Data:
    """The state of one environment; under `jax.vmap`, each field has axes in front. float32, MuJoCo's shapes.

    qpos: [nq], qvel: [nv], act: [na], ctrl: [nu], qacc_warmstart: [nv], time: [] in seconds. history:
    [nhistory], with an actuator's controls in the order of their times; None if none acts late.
    The others are derived: those that `put_model` was asked for, and None. They describe the state that is
    returned (position and velocity stages are computed again after the last substep), except `qfrc_actuator`
    and sensors of forces and accelerations: those are the last substep's.
    """

    qpos: jax.Array
    qvel: jax.Array
    act: jax.Array
    ctrl: jax.Array
    qacc_warmstart: jax.Array
    time: jax.Array
    history: jax.Array | None = None
    cinert: jax.Array | None = None
    cvel: jax.Array | None = None
    geom_xpos: jax.Array | None = None
    qfrc_actuator: jax.Array | None = None
    sensordata: jax.Array | None = None
    site_xpos: jax.Array | None = None
    subtree_com: jax.Array | None = None
    ten_length: jax.Array | None = None
    xmat: jax.Array | None = None
    xpos: jax.Array | None = None
    xquat: jax.Array | None = None

    def replace(self, **values: Any) -> "Data":
        """The same with these fields."""
        return replace(self, **values)


_register(Data, data_fields=[field.name for field in fields(Data)])


def make_data(m: Model) -> Data:
    """The state at the model's `qpos0`, at rest and at time 0; derived fields are zeros until `forward`."""
    return put_data(m, mujoco.MjData(m.moves.model))


def put_data(m: Model, d: mujoco.MjData) -> Data:
    """The state that an `mjData` has, with its derived fields as they are.

    Raises Uncovered if a mocap body is not where the model has it, or the controls for an actuator that acts
    late are not those of the last time steps.
    """
    model = m.moves.model
    moved = mujoco.MjData(model)
    if any((getattr(d, name) != getattr(moved, name)).any() for name in ("mocap_pos", "mocap_quat")):
        raise Uncovered("a mocap body is not where the model has it")
    values = {name: getattr(d, name) for name in m.moves.shapes}
    if "history" in values:
        if not is_of_last_steps(model, d):
            raise Uncovered("the controls in `history` are not those of the last time steps")
        values["history"] = ordered_history(model, d.history)
    return Data(**{name: jnp.asarray(value, jnp.float32) for name, value in values.items()})


def forward(m: Model, d: Data) -> Data:
    """The state with its derived fields computed; it does not move."""
    return d.replace(**m.moves.moved("forward", _inputs(m, d), m.own)) if m.moves.derived else d


def step(m: Model, d: Data) -> Data:
    """The state `nstep` time steps later under its controls, with its derived fields; see `put_model`.

    `jax.vmap` makes it many environments in one call. One that is not finite, or past the bound beyond which
    MuJoCo calls a state unstable, comes back as NaN, and changes no bit of another. On one kind of processor
    every environment has the same result every time, and beside any others.
    """
    duration = jnp.float32(m.moves.nstep * m.moves.model.opt.timestep)
    return d.replace(**m.moves.moved("step", _inputs(m, d), m.own), time=d.time + duration)


def _inputs(m: Model, d: Data) -> dict[str, jax.Array]:
    return {name: getattr(d, name) for name in (*m.moves.carried, "ctrl", "time")}
