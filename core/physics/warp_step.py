"""A substep of MuJoCo Warp whose independent parts run at the same time."""

from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any

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
