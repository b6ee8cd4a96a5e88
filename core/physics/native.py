"""C MuJoCo on the CPU's cores, called from compiled JAX programs."""

import copy
import hashlib
import threading
from collections.abc import Callable, Mapping
from dataclasses import replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco.batch import MODEL_FIELDS, Batch, SimulationError
from numpy.typing import NDArray

from core.devices import num_cores
from core.physics.engine import NOMINAL, ModelFields, PhysicsState, check_model_fields
from core.physics.model import Floats, in_parts, of_parts, with_loose_frames
from mujoco_compiled import host_call

_Move = Callable[[Batch, NDArray[np.intp] | None], None]


class NativeEngine:
    """`mujoco.batch` behind a call to the host; under `jax.vmap` one call moves them all on all cores.

    Environments are float64 inside and float32 outside, but for `PhysicsState.exact`: where the model has
    delays, their history and the time. An environment that is not finite, or for which MuJoCo reports an
    error or a warning (an unstable state, a full contact buffer), comes back as NaN.
    """

    name = "native"

    def __init__(self, model: mujoco.MjModel, num_substeps: int, derived: tuple[str, ...]) -> None:
        self.model = model
        self._batches = _Batches(model)
        self._num_substeps = num_substeps
        self._num_act, self._num_ctrl = model.na, model.nu
        self._fingerprint = _fingerprint(model, num_substeps, derived)
        blank = mujoco.MjData(model)
        carried = ("time", "qpos", "qvel", "act", "qacc_warmstart")
        # Delayed controls and readings are looked up by their times; a rounded time may find another one.
        self._exact = ("history", "time") if model.nhistory else ()
        # Fields without elements are not passed to the callback.
        self._carried = tuple(
            name for name in carried if np.size(getattr(blank, name)) and name not in self._exact
        )
        self._at_time_0 = {name: in_parts(getattr(blank, name)) for name in self._exact}
        self._derived = derived
        stage = mujoco.mjtStage.mjSTAGE_VEL if derived else mujoco.mjtStage.mjSTAGE_NONE
        self._stage_afterwards = int(stage)
        self._shapes = {name: np.shape(getattr(blank, name)) for name in (*carried, *derived)}
        self._shapes.update({name: parts.shape for name, parts in self._at_time_0.items()})

    def reset(
        self,
        qpos: jax.Array,
        qvel: jax.Array,
        model: ModelFields = NOMINAL,
        act: jax.Array | None = None,
    ) -> PhysicsState:
        check_model_fields(model)
        at_rest = PhysicsState(
            qpos=qpos,
            qvel=qvel,
            act=jnp.zeros(self._num_act, jnp.float32) if act is None else act,
            qacc_warmstart=jnp.zeros_like(qvel),
            time=jnp.zeros((), jnp.float32),
            derived={},
            model=model,
            exact={name: jnp.asarray(parts) for name, parts in self._at_time_0.items()},
        )
        if not self._derived:
            return at_rest
        derived = self._fields(Batch.forward, at_rest, jnp.zeros(self._num_ctrl, jnp.float32), self._derived)
        return replace(at_rest, derived=derived)

    def step(self, state: PhysicsState, ctrl: jax.Array) -> PhysicsState:
        def substeps(batch: Batch, ids: NDArray[np.intp] | None) -> None:
            batch.step(ids, nstep=self._num_substeps, stage=self._stage_afterwards)

        fields = self._fields(substeps, state, ctrl, (*self._carried, *self._derived, *self._exact))
        derived = {name: fields.pop(name) for name in self._derived}
        exact = {name: fields.pop(name) for name in self._exact}
        if exact:
            fields["time"] = exact["time"][0]
        return replace(state, **fields, derived=derived, exact=exact)

    def _fields(
        self, move: _Move, state: PhysicsState, ctrl: jax.Array, wanted: tuple[str, ...]
    ) -> dict[str, jax.Array]:
        """The wanted fields after the move, as a node of the compiled program."""
        inputs = {name: getattr(state, name) for name in self._carried} | dict(state.exact)
        if self._num_ctrl:
            inputs["ctrl"] = ctrl
        inputs.update({name: values for name, values in state.model.items() if values.size})

        def on_the_host(*arrays: Floats) -> tuple[Floats, ...]:
            return self._batches.move(move, dict(zip(inputs, arrays, strict=True)), wanted, self._exact)

        name = f"{self._fingerprint} {move.__name__} {','.join(inputs)} to {','.join(wanted)}"
        shapes = [self._shapes[field] for field in wanted]
        values = host_call(on_the_host, name, shapes, *inputs.values())
        return dict(zip(wanted, values, strict=True))


class _Batches:
    """The host's side: a `Batch` for each number of environments and each set of fields they differ in."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = copy.copy(model)
        # MuJoCo would reset an unstable environment and continue; it must be reported instead.
        self._model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        self._batches: dict[tuple[int, frozenset[str]], Batch] = {}
        # Two threads must not use a Batch at once, and JAX may call back from any of its threads.
        self._lock = threading.Lock()

    def move(
        self, move: _Move, arguments: Mapping[str, Floats], wanted: tuple[str, ...], exact: tuple[str, ...]
    ) -> tuple[Floats, ...]:
        """The wanted fields after the move, NaN for a broken environment; leading axes as in `arguments`.

        exact: those of both that are in parts.
        """
        time = arguments["time"]
        batch_shape = time.shape[:-1] if "time" in exact else time.shape
        with self._lock:
            batch = self._batch(int(np.prod(batch_shape)), frozenset(MODEL_FIELDS.intersection(arguments)))
            for name, values in arguments.items():
                field = batch.expand(name) if name in MODEL_FIELDS else batch.bind(name)
                whole = of_parts(values) if name in exact else values
                field[...] = whole.reshape(field.shape)
            outputs = [(batch.bind(name), in_parts if name in exact else _rounded) for name in wanted]
            broken = _broken(batch, move)
            results = [said(output) for output, said in outputs]
        if broken.any():
            for result in results:
                result[broken] = np.nan
        return tuple(result.reshape((*batch_shape, *result.shape[1:])) for result in results)

    def _batch(self, num_envs: int, own_fields: frozenset[str]) -> Batch:
        # A later call would have to undo what `expand` did, so each set of fields has its own Batch.
        key = (num_envs, own_fields)
        if key not in self._batches:
            model = with_loose_frames(self._model, own_fields)
            self._batches[key] = Batch(model, num_envs, nthread=min(num_envs, num_cores()))
        return self._batches[key]


def _rounded(values: NDArray[np.float64]) -> Floats:
    return values.astype(np.float32)


def _broken(batch: Batch, move: _Move) -> NDArray[np.bool_]:
    """Moves the batch; returns which of its environments [nsim] are invalid afterwards.

    An environment that is not finite is not moved: MuJoCo would log several lines for each of its substeps.
    """
    broken = ~np.isfinite(batch.state).all(axis=1)
    batch.warning[...] = 0
    try:
        move(batch, np.flatnonzero(~broken) if broken.any() else None)
    except SimulationError as error:
        broken[error.ids] = True
    number_of_each_kind = batch.warning[:, :, 1]
    return broken | number_of_each_kind.any(axis=1)


def _fingerprint(model: mujoco.MjModel, num_substeps: int, derived: tuple[str, ...]) -> str:
    """Equal for engines that do the same, in any process."""
    content = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, content)
    digest = hashlib.sha256(content.data)
    digest.update(f"{num_substeps} {derived}".encode())
    return digest.hexdigest()
