"""MJX-JAX: MuJoCo rewritten in JAX; it stays on the accelerator and is differentiable."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco import mjx

from core.physics.engine import NOMINAL, ModelFields, PhysicsState, check_model_fields

# Only a whole substep computes these: forces, and the sensors of forces and accelerations.
_OF_THE_LAST_SUBSTEP = ("qfrc_actuator", "sensordata")
# Fields that not every implementation of MJX has.
_INTERNAL = ("cinert",)
_CARRIED = ("time", "qpos", "qvel", "act", "qacc_warmstart")


class MjxEngine:
    """`mjx.step`, over a Data that is rebuilt from a constant one at each substep.

    A state therefore holds only its own few arrays, and `jax.tree.map(where, ...)` over states is right.
    """

    name = "mjx"

    def __init__(self, model: mujoco.MjModel, num_substeps: int, derived: tuple[str, ...]) -> None:
        self.model = model
        self._model = mjx.put_model(model)
        self._blank: Any = mjx.make_data(model)
        self._num_substeps = num_substeps
        self._derived = derived
        self._lasting = tuple(name for name in derived if name in _OF_THE_LAST_SUBSTEP)
        blank = mujoco.MjData(model)
        self._shapes = {name: np.shape(getattr(blank, name)) for name in derived}

    def reset(
        self,
        qpos: jax.Array,
        qvel: jax.Array,
        model: ModelFields = NOMINAL,
        act: jax.Array | None = None,
    ) -> PhysicsState:
        check_model_fields(model)
        held: jax.Array = self._blank.act if act is None else act
        data = self._blank.replace(qpos=qpos, qvel=qvel, act=held)
        if self._derived:
            data = mjx.forward(self._with(model), data)
        return PhysicsState(
            qpos=qpos,
            qvel=qvel,
            act=held,
            qacc_warmstart=jnp.zeros_like(qvel),
            time=jnp.zeros((), jnp.float32),
            derived=self._read(data, self._derived),
            model=model,
        )

    def step(self, state: PhysicsState, ctrl: jax.Array) -> PhysicsState:
        model = self._with(state.model)

        def substep(state: PhysicsState, _: None) -> tuple[PhysicsState, None]:
            return self._state(mjx.step(model, self._data(state).replace(ctrl=ctrl)), self._lasting), None

        lasting = {name: state.derived[name] for name in self._lasting}
        carry = replace(state, derived=lasting, model={})
        after, _ = jax.lax.scan(substep, carry, length=self._num_substeps)
        if self._derived:
            after = self._state(self._fresh(model, self._data(after)), self._derived)
        return replace(after, model=state.model)

    def _with(self, fields: ModelFields) -> Any:
        """The model with these fields instead of its own."""
        return self._model.tree_replace(dict(fields)) if fields else self._model

    def _fresh(self, model: Any, data: Any) -> Any:
        """The same data, with the fields that follow from position and velocity recomputed."""
        if "sensordata" in self._derived:
            # Sensors may read anything; the compiler drops what they do not read.
            data = mjx.sensor_pos(model, mjx.fwd_position(model, data))
            return mjx.sensor_vel(model, mjx.fwd_velocity(model, data))
        data = mjx.com_pos(model, mjx.kinematics(model, data))
        return mjx.com_vel(model, mjx.tendon(model, data))

    def _data(self, state: PhysicsState) -> Any:
        fields = {name: getattr(state, name) for name in _CARRIED}
        return self._blank.replace(**fields, **{name: state.derived[name] for name in self._lasting})

    def _state(self, data: Any, derived: tuple[str, ...]) -> PhysicsState:
        fields = {name: getattr(data, name) for name in _CARRIED}
        return PhysicsState(**fields, derived=self._read(data, derived))

    def _read(self, data: Any, derived: tuple[str, ...]) -> dict[str, jax.Array]:
        """The fields in MuJoCo's shapes: MJX gives matrices as [3, 3] and keeps some fields elsewhere."""
        values = {name: getattr(data._impl if name in _INTERNAL else data, name) for name in derived}
        return {name: value.reshape(self._shapes[name]) for name, value in values.items()}
