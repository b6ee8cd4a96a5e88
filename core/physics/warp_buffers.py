"""MuJoCo Warp's side of the engine `warp`: buffers on the device, and the graphs that move them."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, Literal

import mujoco
import numpy as np
import warp as wp

# Otherwise Warp logs every kernel that it compiles.
wp.config.log_level = wp.LOG_WARNING

from mujoco.mjx.third_party import mujoco_warp as mjw  # noqa: E402

from core.physics.capacity import capacity, measure  # noqa: E402
from core.physics.warp_step import FixedGeoms, Substep, load_kernels  # noqa: E402
from mujoco_compiled import model_field  # noqa: E402

Move = Literal["forward", "step"]

# Without the check, an H200 steps ants (1 iteration) and rodents (4) 5 % and 1 % faster.
_FEW_ITERATIONS = 4
# Bits of `overflow` for a solver that stopped at its limit, as intended, rather than for lost rows.
_NOT_LOST = mjw.OverflowType.ITERATIONS | mjw.OverflowType.LS_ITERATIONS
LOST = int(mjw.OverflowType.ALL & ~_NOT_LOST)


class WarpBuffers:
    """Buffers for each device, each number of worlds, and each set of fields that the worlds differ in.

    inputs, outputs: the fields that a call takes and returns, by MuJoCo's names, with their sizes; after the
    inputs come the fields of the model that the worlds differ in.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        num_substeps: int,
        inputs: Mapping[str, int],
        outputs: Mapping[str, int],
        derived: Sequence[str],
    ) -> None:
        self._model, self._num_substeps = model, num_substeps
        self._inputs, self._outputs, self._derived = dict(inputs), outputs, tuple(derived)
        with wp.ScopedDevice("cpu"):
            pairs = mjw.put_model(model).nxn_geom_pair_filtered.numpy()
        self._demand = measure(model, pairs)
        self._batches: dict[tuple[str, int, tuple[str, ...]], _WorldBatch] = {}
        # One world uses the same kernels as thousands: they compile while JAX traces and compiles.
        in_advance = ThreadPoolExecutor(1)
        self._kernels = in_advance.submit(self._batch, 1, ()) if wp.is_cuda_available() else None
        in_advance.shutdown(wait=False)

    def move(self, move: Move, own: tuple[str, ...], before: Any, after: Any, overflow: Any) -> None:
        """before: [N, sum of inputs]; after: [N, sum of outputs]; overflow: [N], bits of OverflowType.

        own: the fields of the model that `before` holds after the inputs.
        """
        key = (before.device.alias, before.shape[0], own)
        if key not in self._batches:
            if self._kernels is not None:
                self._kernels.result()
            self._batches[key] = self._batch(before.shape[0], own)
        batch = self._batches[key]
        wp.copy(batch.before, before)
        batch.run(move)
        wp.copy(after, batch.after)
        wp.copy(overflow, batch.data.overflow)

    def _batch(self, num_worlds: int, own: tuple[str, ...]) -> "_WorldBatch":
        model = mjw.put_model(
            self._model, batch_sizes={name: num_worlds for name in own if not name.startswith("opt.")}
        )
        if "opt.gravity" in own:
            model.opt.gravity = wp.array(np.tile(self._model.opt.gravity, (num_worlds, 1)), dtype=wp.vec3)
        # A loop in a graph checks after each iteration whether to continue: dearer than a few iterations.
        model.opt.graph_conditional = self._model.opt.iterations > _FEW_ITERATIONS
        model.opt.warn_overflow = 0  # it would print a line from the kernel for every world and step
        room = capacity(self._demand, num_worlds)
        data = mjw.make_data(self._model, num_worlds, naconmax=room.naconmax, njmax=room.njmax)
        sizes = {name: np.size(model_field(self._model, name)) for name in own}
        batch = _WorldBatch(
            model, data, self._num_substeps, self._inputs | sizes, self._outputs, self._derived
        )
        if "geom_pos" in own:
            batch.fixed_geoms = FixedGeoms(self._model, own, data.qpos.device)
        return batch


class _WorldBatch:
    """Buffers for one number of worlds, and the programs over them: on a GPU, each is one CUDA graph.

    A call copies into `before` and out of `after`, so the graphs stay valid whatever buffers JAX passes.
    fixed_geoms: those that worlds have in other places; None: all have the model's.
    """

    fixed_geoms: FixedGeoms | None = None

    def __init__(
        self,
        model: Any,
        data: Any,
        num_substeps: int,
        inputs: Mapping[str, int],
        outputs: Mapping[str, int],
        derived: tuple[str, ...],
    ) -> None:
        self.data = data
        self._model, self._num_substeps, self._derived = model, num_substeps, derived
        self.before = wp.zeros((data.nworld, sum(inputs.values())), dtype=wp.float32)
        self.after = wp.zeros((data.nworld, sum(outputs.values())), dtype=wp.float32)
        self._loads = self._columns(self.before, inputs)
        self._stores = self._columns(self.after, outputs)
        device = self.data.qpos.device
        self._substep = Substep(model, device, reads_sensors="sensordata" in derived)
        self._graphs: dict[Move, Any] = {}
        if device.is_cuda:
            step = partial(self._step, in_sequence=True)
            load_kernels([step, *([self._forward] if derived else [])], device)

    def run(self, move: Move) -> None:
        """From `before` to `after`."""
        program = self._forward if move == "forward" else self._step
        if not self.data.qpos.device.is_cuda:
            program()
        elif move in self._graphs:
            wp.capture_launch(self._graphs[move])
        else:
            program()  # loads the kernels and allocates, which must not happen during a capture
            with wp.ScopedCapture() as capture:
                program()
            self._graphs[move] = capture.graph

    def _forward(self) -> None:
        self._load()
        mjw.forward(self._model, self.data)
        self._store()

    def _step(self, *, in_sequence: bool = False) -> None:
        self._load()
        for _ in range(self._num_substeps):
            self._substep(self.data, in_sequence=in_sequence)
        if self._derived:
            self._refresh(self._model, self.data)
        self._store()

    def _refresh(self, model: Any, data: Any) -> None:
        """The fields that follow from position and velocity, for the state that is returned."""
        if "sensordata" in self._derived:  # a sensor may read anything
            mjw.fwd_position(model, data)
            mjw.sensor_pos(model, data)
            mjw.fwd_velocity(model, data)
            mjw.sensor_vel(model, data)
        else:
            mjw.kinematics(model, data)
            mjw.com_pos(model, data)
            mjw.tendon(model, data)
            mjw.com_vel(model, data)

    def _load(self) -> None:
        self.data.overflow.zero_()
        for column, field in self._loads:
            wp.copy(field, column)
        if self.fixed_geoms is not None:
            self.fixed_geoms.place(self._model, self.data)

    def _store(self) -> None:
        for column, field in self._stores:
            wp.copy(column, field)

    def _columns(self, packed: Any, sizes: Mapping[str, int]) -> list[tuple[Any, Any]]:
        """Each field's columns of the packed array, and the field itself as [N, size] of numbers."""
        ends = np.cumsum(list(sizes.values()))
        pairs: list[tuple[Any, Any]] = []
        for (name, size), end in zip(sizes.items(), ends.tolist(), strict=True):
            field = getattr(self.data, name) if hasattr(self.data, name) else model_field(self._model, name)
            flat = wp.array(
                ptr=field.ptr, dtype=wp.float32, shape=(self.data.nworld, size), device=field.device
            )
            pairs.append((packed[:, end - size : end], flat))
        return pairs


def program(buffers: WarpBuffers, move: Move, own: tuple[str, ...]) -> Callable[..., Any]:
    """The move as a function of JAX arrays: [1, inputs] to ([1, outputs], [1] int32); `vmap` makes 1 many.

    own: the fields of the model that the worlds differ in, which they pass.
    """

    def call(
        before: wp.array2d[wp.float32], after: wp.array2d[wp.float32], overflow: wp.array[wp.int32]
    ) -> None:
        buffers.move(move, own, before, after, overflow)

    # We capture graphs ourselves: Warp would capture one again for each pair of buffers that JAX passes.
    return wp.jax_callable(
        call, num_outputs=2, graph_mode=wp.JaxCallableGraphMode.NONE, vmap_method="broadcast_all"
    )
