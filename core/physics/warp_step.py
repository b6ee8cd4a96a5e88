"""A substep of MuJoCo Warp whose independent parts run at the same time, and whose kernels compile so, too.

Geoms that never move have their places in each world: MuJoCo Warp places them once, where the model does.
"""

# A kernel is Warp's language, which only looks like Python.
# pyright: reportUntypedFunctionDecorator=false, reportAssignmentType=false
# pyright: reportGeneralTypeIssues=false, reportIndexIssue=false

import os
import threading
from collections.abc import Callable, Collection, Generator, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Any

import mujoco
import numpy as np
import warp as wp
from mujoco.mjx.third_party import mujoco_warp as mjw
from mujoco.mjx.third_party.mujoco_warp._src import smooth

_ONE_STAGE = (mjw.IntegratorType.EULER, mjw.IntegratorType.IMPLICITFAST)


class Substep:
    """`mujoco_warp.step` as a graph of kernels instead of a sequence.

    A substep is some ninety short kernels, and for a small body their launches take the time: the ant's
    (4096 worlds) takes 4.5 µs per kernel on an H200. Contacts and their rows, the inertia matrix, and the
    forces that follow from velocity do not depend on each other once the bodies' positions are known, so a
    CUDA graph that is captured over three streams runs them side by side. On a CPU they run in sequence.

    Cameras, lights, energies and sensors are left out: no physics depends on them. A model whose sensors
    are read, or that sleeps, integrates in several stages or has callbacks takes MuJoCo Warp's own step.
    """

    def __init__(self, model: Any, device: Any, *, reads_sensors: bool) -> None:
        self._model = model
        self._is_plain = not reads_sensors and _is_plain(model)
        num_streams = 2 if device.is_cuda and self._is_plain else 0
        self._streams = [wp.Stream(device) for _ in range(num_streams)]

    def __call__(self, data: Any, *, in_sequence: bool = False) -> None:
        """Moves every world of `data` by one time step. in_sequence: on the device's present stream alone.

        A device has one present stream for all threads: a thread beside others must not change it, or theirs
        launch where JAX does not wait for them, and it reads what is not written yet.
        """
        streams = [] if in_sequence else self._streams
        if not self._is_plain:
            mjw.step(self._model, data)
            return
        model = self._model
        mjw.kinematics(model, data)
        mjw.com_pos(model, data)
        mjw.flex(model, data)
        mjw.tendon(model, data)
        with _beside(streams, 0):
            if model.opt.run_collision_detection:
                mjw.collision(model, data)
            mjw.make_constraint(model, data)
        with _beside(streams, 1):
            mjw.crb(model, data)
            smooth.tendon_armature(model, data)
        mjw.transmission(model, data)
        mjw.fwd_velocity(model, data)
        mjw.fwd_actuation(model, data)
        _join(streams, 1)
        mjw.fwd_acceleration(model, data, factorize=True)
        _join(streams, 0)
        mjw.solve(model, data)
        if model.opt.integrator == mjw.IntegratorType.EULER:
            mjw.euler(model, data)
        else:
            mjw.implicit(model, data)


def _beside(streams: Sequence[Any], index: int) -> AbstractContextManager[Any]:
    """Launches inside begin after earlier ones; later ones do not wait for them until `_join`."""
    return wp.ScopedStream(streams[index]) if streams else nullcontext()


def _join(streams: Sequence[Any], index: int) -> None:
    if streams:
        wp.wait_stream(streams[index])


def _is_plain(model: Any) -> bool:
    callbacks = model.callback
    has_callbacks = any(getattr(callbacks, name) for name in vars(callbacks))
    sleeps = bool(model.opt.enableflags & mjw.EnableBit.SLEEP)
    return model.opt.integrator in _ONE_STAGE and not sleeps and not has_callbacks


@wp.kernel
def _place(
    numbers: wp.array[int],
    origins: wp.array[wp.vec3],
    rotations: wp.array[wp.mat33],
    geom_pos: wp.array2d[wp.vec3],
    geom_xpos: wp.array2d[wp.vec3],
) -> None:
    world, index = wp.tid()
    geom = numbers[index]
    geom_xpos[world, geom] = origins[index] + rotations[index] @ geom_pos[world, geom]


@wp.kernel
def _turn(
    numbers: wp.array[int],
    rotations: wp.array[wp.mat33],
    geom_quat: wp.array2d[wp.quat],
    geom_xmat: wp.array2d[wp.mat33],
) -> None:
    world, index = wp.tid()
    geom = numbers[index]
    q = geom_quat[world, geom]
    # MuJoCo has the real part first, and Warp last.
    turn = wp.quat_to_matrix(wp.quat(q[1], q[2], q[3], q[0]))  # pyright: ignore[reportArgumentType]
    geom_xmat[world, geom] = rotations[index] @ turn  # pyright: ignore[reportOperatorIssue]


class FixedGeoms:
    """The geoms of bodies that never move. own: the fields of the model that worlds have for themselves."""

    def __init__(self, model: mujoco.MjModel, own: Collection[str], device: Any) -> None:
        at_rest = mujoco.MjData(model)
        mujoco.mj_kinematics(model, at_rest)
        numbers = np.flatnonzero(model.body_weldid[model.geom_bodyid] == 0)
        bodies = model.geom_bodyid[numbers]
        self._turns = "geom_quat" in own
        self._numbers = wp.array(numbers, dtype=int, device=device)
        self._origins = wp.array(at_rest.xpos[bodies], dtype=wp.vec3, device=device)
        self._rotations = wp.array(at_rest.xmat[bodies].reshape(-1, 3, 3), dtype=wp.mat33, device=device)

    def place(self, model: Any, data: Any) -> None:
        """Sets their `geom_xpos` from the worlds' own `geom_pos`, and `geom_xmat` from their `geom_quat`."""
        every: dict[str, Any] = {"dim": (data.nworld, len(self._numbers)), "device": data.qpos.device}
        places = [self._numbers, self._origins, self._rotations, model.geom_pos]
        wp.launch(_place, inputs=places, outputs=[data.geom_xpos], **every)
        if self._turns:
            turns = [self._numbers, self._rotations, model.geom_quat]
            wp.launch(_turn, inputs=turns, outputs=[data.geom_xmat], **every)


_BLOCK_DIM = 256  # Warp's default


def load_kernels(programs: Iterable[Callable[[], None]], device: Any) -> None:
    """Compile and load the kernels that these programs launch, without running them.

    Warp compiles each module at its first launch, one after the other: half a minute for the forty modules of
    a substep. Side by side they take 12 s on 16 cores. Modules in Warp's cache are only loaded.

    programs: must launch the same kernels whatever the arrays hold.
    """
    with _launches_noted() as needed:
        for program in programs:
            program()
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(lambda one: one[0].load(device, one[1] if device.is_cuda else 1), needed))


@contextmanager
def _launches_noted() -> Generator[dict[tuple[Any, int], None]]:
    """Records the (module, size of thread blocks) of launches instead of launching; loops run once.

    Affects only this thread. Warp has no dry run of its own.
    """
    needed, thread = dict[tuple[Any, int], None](), threading.get_ident()
    launch, launch_tiled, capture_while = wp.launch, wp.launch_tiled, wp.capture_while

    def noting(real: Callable[..., Any]) -> Callable[..., Any]:
        def note(kernel: Any, *arguments: Any, block_dim: int = _BLOCK_DIM, **named: Any) -> Any:
            if threading.get_ident() != thread:
                return real(kernel, *arguments, block_dim=block_dim, **named)
            needed[kernel.module, block_dim] = None
            return None

        return note

    def enter(condition: Any, while_body: Callable[..., None], **named: Any) -> None:
        if threading.get_ident() == thread:
            while_body(**named)
        else:
            capture_while(condition, while_body, **named)

    wp.launch, wp.launch_tiled, wp.capture_while = noting(launch), noting(launch_tiled), enter
    try:
        yield needed
    finally:
        wp.launch, wp.launch_tiled, wp.capture_while = launch, launch_tiled, capture_while
