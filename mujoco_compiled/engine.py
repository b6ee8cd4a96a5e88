"""Code made for one body: its control step without anything that another body would need."""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Literal

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from core.physics.engine import NOMINAL, ModelFields, PhysicsState, check_model_fields
from core.physics.model import model_field
from mujoco_compiled.code.function_source import FunctionSource
from mujoco_compiled.refusal import check_covered, check_own
from mujoco_compiled.write import Plan, control_step_in_lanes, control_step_program, derived_program

_Move = Literal["reset", "step"]
_Call = Callable[..., tuple[jax.Array, ...]]
_CARRIED = ("qpos", "qvel", "act", "qacc_warmstart")
# Derived fields that may depend on activations.
_OF_FORCES = {"qfrc_actuator", "sensordata"}


class CompiledEngine:
    """One call moves all environments a whole control step; `jax.vmap` makes it one call.

    An environment that is not finite, or past MuJoCo's own bound, comes back as NaN. On one kind of processor
    every environment has the same result every time, and beside any others.
    """

    name = "compiled"

    def __init__(self, model: mujoco.MjModel, num_substeps: int, derived: tuple[str, ...]) -> None:
        check_covered(model, derived)
        self.model, self._num_substeps, self._derived = model, num_substeps, derived
        self._described = f"{_fingerprint(model)} {num_substeps} {derived}"
        blank = mujoco.MjData(model)
        names = (*_CARRIED, "time", "ctrl", *derived)
        self._shapes = {name: np.shape(getattr(blank, name)) for name in names}
        self._calls: dict[tuple[_Move, tuple[str, ...]], tuple[FunctionSource, _Call]] = {}
        # Its code is made while JAX traces and compiles.
        self._call("step", ())

    def reset(
        self,
        qpos: jax.Array,
        qvel: jax.Array,
        model: ModelFields = NOMINAL,
        act: jax.Array | None = None,
    ) -> PhysicsState:
        check_model_fields(model)
        check_own(self.model, tuple(model), self._derived)
        at_rest = PhysicsState(
            qpos=qpos,
            qvel=qvel,
            act=jnp.zeros(self.model.na, jnp.float32) if act is None else act,
            qacc_warmstart=jnp.zeros_like(qvel),
            time=jnp.zeros((), jnp.float32),
            derived={},
            model=model,
        )
        return replace(at_rest, derived=self._moved("reset", at_rest, {})) if self._derived else at_rest

    def step(self, state: PhysicsState, ctrl: jax.Array) -> PhysicsState:
        fields = self._moved("step", state, {"ctrl": ctrl})
        derived = {name: fields.pop(name) for name in self._derived}
        duration = jnp.float32(self._num_substeps * self.model.opt.timestep)
        return replace(state, time=state.time + duration, derived=derived, **fields)

    def _moved(self, move: _Move, state: PhysicsState, more: Mapping[str, jax.Array]) -> dict[str, jax.Array]:
        """The fields after the move, in MuJoCo's shapes."""
        own = tuple(name for name, values in sorted(state.model.items()) if values.size)
        source, call = self._call(move, own)
        fields = {name: getattr(state, name) for name in (*_CARRIED, "time")} | {**state.model, **more}
        values = call(*(jnp.ravel(jnp.asarray(fields[name], jnp.float32)) for name in source.inputs))
        found = dict(zip(source.outputs, values, strict=True))
        wanted = (*(_CARRIED if move == "step" else ()), *self._derived)
        return {
            name: found[name].reshape(self._shapes[name]) if name in found else jnp.zeros(self._shapes[name])
            for name in wanted
        }

    def _call(self, move: _Move, own: tuple[str, ...]) -> tuple[FunctionSource, _Call]:
        """The move, for environments that differ in these fields of the model."""
        if (move, own) not in self._calls:
            check_own(self.model, own, self._derived)
            source = self._source(move, own)
            self._calls[move, own] = source, _on_this_device(source)
        return self._calls[move, own]

    def _source(self, move: _Move, own: tuple[str, ...]) -> FunctionSource:
        read = {"step": (*_CARRIED, "ctrl"), "reset": ("qpos", "qvel")}[move]
        if move == "reset" and not _OF_FORCES.isdisjoint(self._derived):
            read = (*read, "act")
        reads_time = move == "step" and "sensordata" in self._derived
        own_sizes = {name: np.size(model_field(self.model, name)) for name in own}
        inputs = self._sizes((*read, "time") if reads_time else read) | own_sizes
        written = self._sizes((*(_CARRIED if move == "step" else ()), *self._derived))
        plan = Plan(self.model, inputs, own, self._derived)
        described = f"{move} {self._described} {own}"
        if move == "reset":
            write = partial(derived_program, plan)
            return FunctionSource(described, write, write, inputs, written)
        write, in_lanes = (
            partial(one, plan, self._num_substeps) for one in (control_step_program, control_step_in_lanes)
        )
        return FunctionSource(described, write, in_lanes, inputs, written)

    def _sizes(self, names: tuple[str, ...]) -> dict[str, int]:
        """Fields without elements are neither read nor written."""
        return {name: size for name in names if (size := int(np.prod(self._shapes[name])))}


def _on_this_device(source: FunctionSource) -> _Call:
    """The function for the processor that JAX uses."""
    if jax.default_backend() == "cpu":
        from mujoco_compiled.code.cpu_call import CpuCall

        return CpuCall(source)
    from mujoco_compiled.code.gpu_call import GpuCall

    return GpuCall(source)


def _fingerprint(model: mujoco.MjModel) -> str:
    """Equal for equal models, in any process."""
    content = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, content)
    return hashlib.sha256(content.data).hexdigest()
