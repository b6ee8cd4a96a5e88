"""MuJoCo Warp: MuJoCo written in CUDA kernels, for bodies with many contacts on a GPU."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from numpy.typing import NDArray

from core.errors import JobFailed
from core.physics.engine import NOMINAL, OVERFLOW, ModelFields, PhysicsState, check_model_fields
from core.physics.warp_buffers import LOST, Move, WarpBuffers, program
from core.reasons import Reason
from mujoco_compiled import model_field

_CARRIED = ("qpos", "qvel", "act", "qacc_warmstart", "time")


class WarpEngine:
    """One call steps all worlds of a batch in MuJoCo Warp's own Data, a whole control step at a time.

    A state holds only its few arrays: they go in as one row [K] and come back as another, so no contact or
    constraint ever passes through JAX. `jax.vmap` stacks the rows; the first call's batch shows how many
    worlds there are, and so how large the buffers must be.

    A world that is not finite, or past MuJoCo's own bound, comes back as NaN. `derived["overflow"]` is 1
    where contacts or constraint rows had no room in this step and were lost. A full buffer of contacts, which
    all worlds share, marks every world. Their numbers are finite, and slightly wrong.
    """

    name = "warp"

    def __init__(self, model: mujoco.MjModel, num_substeps: int, derived: tuple[str, ...]) -> None:
        blank = mujoco.MjData(model)
        self._num_ctrl, self._num_act = model.nu, model.na
        self._shapes = {name: np.shape(getattr(blank, name)) for name in (*_CARRIED, *derived)}
        before = {name: np.asarray(getattr(blank, name), np.float32).ravel() for name in (*_CARRIED, "ctrl")}
        self._blank = np.concatenate(list(before.values()))
        self.model = model
        # Fields without elements are not copied.
        inputs = {name: values.size for name, values in before.items() if values.size}
        outputs = {name: size for name, shape in self._shapes.items() if (size := int(np.prod(shape)))}
        try:
            self._buffers = WarpBuffers(model, num_substeps, inputs, outputs, derived)
        except (NotImplementedError, ValueError) as error:
            raise JobFailed(Reason.BAD_MODEL, f"MuJoCo Warp cannot run this model: {error}") from error
        self._num_outputs = sum(outputs.values())
        self._num_carried = sum(outputs.get(name, 0) for name in _CARRIED)
        self._derived = derived
        self._programs: dict[tuple[Move, tuple[str, ...]], Callable[..., Any]] = {}

    def reset(
        self,
        qpos: jax.Array,
        qvel: jax.Array,
        model: ModelFields = NOMINAL,
        act: jax.Array | None = None,
    ) -> PhysicsState:
        check_model_fields(model)
        if "dof_damping" in model and self.model.actuator_damping.any():
            raise JobFailed(
                Reason.BAD_MODEL,
                "MuJoCo Warp adds the actuators' damping to the joints' when it loads this model, so "
                "dof_damping cannot differ between environments; choose another engine with `physics`.",
            )
        at_rest = PhysicsState(
            qpos=qpos,
            qvel=qvel,
            act=jnp.zeros(self._num_act, jnp.float32) if act is None else act,
            qacc_warmstart=jnp.zeros_like(qvel),
            time=jnp.zeros((), jnp.float32),
            derived={OVERFLOW: jnp.zeros((), jnp.float32)},
            model=model,
        )
        if not self._derived:
            return at_rest
        after = self._moved("forward", at_rest, jnp.zeros(self._num_ctrl, jnp.float32))
        return replace(at_rest, derived=after.derived)

    def step(self, state: PhysicsState, ctrl: jax.Array) -> PhysicsState:
        return self._moved("step", state, ctrl)

    def _moved(self, move: Move, state: PhysicsState, ctrl: jax.Array) -> PhysicsState:
        own = {name: values for name, values in sorted(state.model.items()) if values.size}
        fields = [getattr(state, name) for name in _CARRIED]
        before = jnp.concatenate([jnp.ravel(field) for field in (*fields, ctrl, *own.values())])
        # A broken world could use up the others' room, so one at the model's qpos0 is stepped in its place.
        was_sound = _is_sound(before)
        rows, bits = self._program(move, tuple(own))(
            jnp.where(was_sound, before, self._blank_with(tuple(own)))[None],
            output_dims={"after": (1, self._num_outputs), "overflow": (1,)},
        )
        is_sound = was_sound & _is_sound(rows[0, : self._num_carried])
        values = self._unpacked(jnp.where(is_sound, rows[0], jnp.nan))
        derived = {name: values[name] for name in self._derived}
        lost = is_sound & ((bits[0] & LOST) != 0)
        return PhysicsState(
            **{name: values[name] for name in _CARRIED},
            derived={**derived, OVERFLOW: jnp.where(lost, 1.0, 0.0).astype(jnp.float32)},
            model=state.model,
            exact={},
        )

    def _program(self, move: Move, own: tuple[str, ...]) -> Callable[..., Any]:
        """The move, for worlds that differ in these fields of the model."""
        if (move, own) not in self._programs:
            self._programs[move, own] = program(self._buffers, move, own)
        return self._programs[move, own]

    def _blank_with(self, own: tuple[str, ...]) -> NDArray[np.float32]:
        nominal = [np.asarray(model_field(self.model, name), np.float32).ravel() for name in own]
        return np.concatenate([self._blank, *nominal])

    def _unpacked(self, row: jax.Array) -> Mapping[str, jax.Array]:
        """The row [sum of outputs] as fields in MuJoCo's shapes."""
        ends = np.cumsum([int(np.prod(shape)) for shape in self._shapes.values()])
        pieces = jnp.split(row, ends[:-1].tolist())
        return {
            name: piece.reshape(shape)
            for (name, shape), piece in zip(self._shapes.items(), pieces, strict=True)
        }


def _is_sound(values: jax.Array) -> jax.Array:
    """Whether all values are finite and within the bound beyond which MuJoCo calls a state unstable; []."""
    return jnp.all(jnp.abs(values) <= mujoco.mjMAXVAL)
