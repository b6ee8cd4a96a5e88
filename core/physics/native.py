"""C MuJoCo on the CPU's cores, called from compiled JAX programs."""

import copy
import os
import sys
import threading
from collections.abc import Callable, Mapping
from dataclasses import replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax.typing import ArrayLike
from mujoco.batch import MODEL_FIELDS, Batch, SimulationError
from numpy.typing import NDArray

from core.physics.engine import NOMINAL, ModelFields, PhysicsState, check_model_fields

_Floats = NDArray[np.float32]
_Move = Callable[[Batch, NDArray[np.intp] | None], None]


class NativeEngine:
    """`mujoco.batch` behind `jax.pure_callback`; under `jax.vmap` one call moves all worlds on all cores.

    Worlds are float64 inside and float32 outside. A world that is not finite, or of which MuJoCo reports
    an error or a warning (an unstable state, a full contact buffer), comes back as NaN.
    """

    name = "native"

    def __init__(self, model: mujoco.MjModel, num_substeps: int, derived: tuple[str, ...]) -> None:
        self._worlds = _Worlds(model)
        self._num_substeps = num_substeps
        self._num_act, self._num_ctrl = model.na, model.nu
        blank = mujoco.MjData(model)
        carried = ("time", "qpos", "qvel", "act", "qacc_warmstart")
        # A callback is not given fields without elements: there is nothing in them to bring or fetch.
        self._carried = tuple(name for name in carried if np.size(getattr(blank, name)))
        self._derived = derived
        stage = mujoco.mjtStage.mjSTAGE_VEL if derived else mujoco.mjtStage.mjSTAGE_NONE
        self._stage_afterwards = int(stage)
        self._shapes = {name: np.shape(getattr(blank, name)) for name in (*carried, *derived)}

    def reset(self, qpos: jax.Array, qvel: jax.Array, model: ModelFields = NOMINAL) -> PhysicsState:
        check_model_fields(model)
        at_rest = PhysicsState(
            qpos=qpos,
            qvel=qvel,
            act=jnp.zeros(self._num_act, jnp.float32),
            qacc_warmstart=jnp.zeros_like(qvel),
            time=jnp.zeros((), jnp.float32),
            derived={},
            model=model,
        )
        if not self._derived:
            return at_rest
        derived = self._fields(Batch.forward, at_rest, jnp.zeros(self._num_ctrl, jnp.float32), self._derived)
        return replace(at_rest, derived=derived)

    def step(self, state: PhysicsState, ctrl: jax.Array) -> PhysicsState:
        def substeps(batch: Batch, ids: NDArray[np.intp] | None) -> None:
            batch.step(ids, nstep=self._num_substeps, stage=self._stage_afterwards)

        fields = self._fields(substeps, state, ctrl, (*self._carried, *self._derived))
        derived = {name: fields.pop(name) for name in self._derived}
        return replace(state, **fields, derived=derived)

    def _fields(
        self, move: _Move, state: PhysicsState, ctrl: jax.Array, wanted: tuple[str, ...]
    ) -> dict[str, jax.Array]:
        """The wanted fields after the move, as a node of the compiled program."""
        inputs = {name: getattr(state, name) for name in self._carried}
        if self._num_ctrl:
            inputs["ctrl"] = ctrl
        inputs.update({name: values for name, values in state.model.items() if values.size})

        def on_the_host(*arrays: ArrayLike) -> tuple[_Floats, ...]:
            # These are JAX's arrays, and JAX must not be called in here: they become NumPy's at once.
            given = dict(zip(inputs, map(np.asarray, arrays), strict=True))
            return self._worlds.move(move, given, wanted)

        results = tuple(jax.ShapeDtypeStruct(self._shapes[name], jnp.float32) for name in wanted)
        values = jax.pure_callback(on_the_host, results, *inputs.values(), vmap_method="broadcast_all")
        return dict(zip(wanted, values, strict=True))


class _Worlds:
    """The host's side: a `Batch` for each number of worlds, and each set of fields that they differ in."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = copy.copy(model)
        # MuJoCo would put an unstable world back to its beginning and go on; we want to hear of it.
        self._model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        self._batches: dict[tuple[int, frozenset[str]], Batch] = {}
        # A Batch must not be used by two threads at once, and JAX may call back from any of its own.
        self._lock = threading.Lock()

    def move(self, move: _Move, given: Mapping[str, _Floats], wanted: tuple[str, ...]) -> tuple[_Floats, ...]:
        """The wanted fields after the move, NaN for a world that broke; leading axes as those of `given`."""
        worlds = given["time"].shape
        with self._lock:
            batch = self._batch(int(np.prod(worlds)), frozenset(MODEL_FIELDS.intersection(given)))
            for name, values in given.items():
                field = batch.expand(name) if name in MODEL_FIELDS else batch.bind(name)
                field[...] = values.reshape(field.shape)
            outputs = [batch.bind(name) for name in wanted]
            broken = _broken(batch, move)
            results = [output.astype(np.float32) for output in outputs]
        if broken.any():
            for result in results:
                result[broken] = np.nan
        return tuple(result.reshape((*worlds, *result.shape[1:])) for result in results)

    def _batch(self, num_worlds: int, own_fields: frozenset[str]) -> Batch:
        # What one call expands, another would have to put back: so each set of fields has its own.
        key = (num_worlds, own_fields)
        if key not in self._batches:
            self._batches[key] = Batch(self._model, num_worlds, nthread=min(num_worlds, _num_cores()))
        return self._batches[key]


def _broken(batch: Batch, move: _Move) -> NDArray[np.bool_]:
    """Moves the batch; which of its worlds [nsim] are not to be believed afterwards.

    A world that is not finite stays where it is: MuJoCo would log several lines for every substep of it.
    """
    broken = ~np.isfinite(batch.state).all(axis=1)
    batch.warning[...] = 0
    try:
        move(batch, np.flatnonzero(~broken) if broken.any() else None)
    except SimulationError as error:
        broken[error.ids] = True
    number_of_each_kind = batch.warning[:, :, 1]
    return broken | number_of_each_kind.any(axis=1)


def _num_cores() -> int:
    """The cores that this process may use."""
    if sys.platform == "linux":
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
