"""Code made for one body: its control step without anything that another body would need."""

import hashlib
from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from core.physics.compiled.code.piece import Piece
from core.physics.compiled.refusal import check_covered
from core.physics.compiled.substep import read_model
from core.physics.compiled.write import control_step_program
from core.physics.engine import NOMINAL, ModelFields, PhysicsState, check_model_fields

_CARRIED = ("qpos", "qvel", "qacc_warmstart")
# In float32 no solver gets below this part of its cost.
_LEAST_TOLERANCE = 1e-6


class CompiledEngine:
    """One call moves all environments a whole control step; `jax.vmap` makes it one call.

    An environment that is not finite, or past MuJoCo's own bound, comes back as NaN.
    """

    name = "compiled"

    def __init__(self, model: mujoco.MjModel, num_substeps: int, derived: tuple[str, ...]) -> None:
        check_covered(model, derived)
        self._model, self._num_substeps, self._derived = model, num_substeps, derived
        self._duration = num_substeps * model.opt.timestep
        self._step = _call(self._control_step())

    def reset(self, qpos: jax.Array, qvel: jax.Array, model: ModelFields = NOMINAL) -> PhysicsState:
        check_model_fields(model)
        return PhysicsState(
            qpos=qpos,
            qvel=qvel,
            act=jnp.zeros(self._model.na, jnp.float32),
            qacc_warmstart=jnp.zeros_like(qvel),
            time=jnp.zeros((), jnp.float32),
            derived={},
            model=model,
        )

    def step(self, state: PhysicsState, ctrl: jax.Array) -> PhysicsState:
        given = {name: getattr(state, name) for name in _CARRIED}
        if self._model.nu:
            given["ctrl"] = ctrl
        outputs = dict(zip(_CARRIED, self._step(*given.values()), strict=True))
        return replace(state, time=state.time + jnp.float32(self._duration), **outputs)

    def _control_step(self) -> Piece:
        model = self._model
        outputs = {"qpos": model.nq, "qvel": model.nv, "qacc_warmstart": model.nv}
        inputs = outputs | ({"ctrl": model.nu} if model.nu else {})
        read = read_model(model)
        tolerance = max(_LEAST_TOLERANCE, read.solver.tolerance)
        read = replace(read, solver=replace(read.solver, tolerance=tolerance))
        described = f"{_fingerprint(model)} {self._num_substeps} {self._derived}"
        return Piece(
            described, lambda: control_step_program(read, self._num_substeps, inputs), inputs, outputs
        )


def _call(piece: Piece) -> Callable[..., tuple[jax.Array, ...]]:
    """The piece on the processor that JAX uses."""
    from core.physics.compiled.code.cpu_call import CpuCall

    if jax.default_backend() == "cpu":
        return CpuCall(piece)
    from core.physics.compiled.code.gpu_call import GpuCall

    return GpuCall(piece)


def _fingerprint(model: mujoco.MjModel) -> str:
    content = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, content)
    return hashlib.sha256(content.tobytes()).hexdigest()
