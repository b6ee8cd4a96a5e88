"""Actuators that act late: by the controls of time steps before.

MuJoCo keeps an actuator's last controls with their times, and looks up the one of a delay ago, or a value
between two of them. Here a time step always has the same length, so that what it finds is a sum of these
controls with constant weights: MuJoCo's own reading of them says which.
Source: MuJoCo's documentation, XML reference, "actuator/general/delay", "nsample", "interp".
"""

import copy
from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from mujoco_compiled.program.arithmetic import Number, Vector, dot

# Of a time step: delays that differ less from a whole number of them are meant to be that.
_DIGITS = 9


@dataclass(frozen=True)
class Late:
    """first: the place of its oldest control among those that the state has. weights: of these, the oldest
    first."""

    first: int
    weights: tuple[float, ...]

    def control(self, history: Vector) -> Number:
        """The control by which it acts. history: of all actuators that act late."""
        return dot(self.weights, history[self.first : self.first + len(self.weights)])

    def remember(self, history: Vector, control: Number) -> None:
        """Puts a time step's control behind the others (changed)."""
        end = self.first + len(self.weights)
        history[self.first : end] = [*history[self.first + 1 : end], control]


def read_late(model: mujoco.MjModel) -> Mapping[int, Late]:
    """By number: the actuators that act late."""
    late = _late(model)
    if not late:
        return {}
    # In time steps, so that times are integers and none is missed by rounding.
    counted, found, first = copy.copy(model), dict[int, Late](), 0
    counted.opt.timestep = 1.0
    counted.actuator_delay[:] = np.round(model.actuator_delay / model.opt.timestep, _DIGITS)
    data = mujoco.MjData(counted)
    for number in late:
        size = _size(model, number)
        weights = tuple(_read(counted, data, number, one) for one in np.eye(size))
        found[number] = Late(first, weights)
        first += size
    return found


def control_places(model: mujoco.MjModel) -> dict[int, list[int]]:
    """By number of an actuator that acts late: where an `ordered_history` has its controls."""
    return {number: _parts(model, number)[1] for number in _late(model)}


def time_places(model: mujoco.MjModel) -> dict[int, list[int]]:
    """Where it has their times."""
    return {number: _parts(model, number)[0] for number in _late(model)}


def ordered_history(model: mujoco.MjModel, history: NDArray[np.float64]) -> NDArray[np.float64]:
    """MuJoCo's `history` [nhistory] with each late actuator's controls in the order of their times, from the
    oldest on. It says the same; in a state of MuJoCo's, any of them may be the oldest."""
    found = np.array(history)
    for number in _late(model):
        times, controls = _parts(model, number)
        newest = times[0] - 1
        turn = -1 - int(found[newest])
        for places in (times, controls):
            found[places] = np.roll(found[places], turn)
        found[newest] = len(times) - 1
    return found


def is_of_last_steps(model: mujoco.MjModel, data: mujoco.MjData) -> bool:
    """Whether the controls in a state's history are those of the last time steps."""
    found, timestep = ordered_history(model, data.history), model.opt.timestep
    for number in _late(model):
        times = found[_parts(model, number)[0]]
        wanted = data.time - timestep * np.arange(len(times), 0, -1)
        if np.abs(times - wanted).max() > 1e-3 * timestep:
            return False
    return True


def _late(model: mujoco.MjModel) -> list[int]:
    return np.flatnonzero(model.actuator_delay > 0).tolist()


def _size(model: mujoco.MjModel, number: int) -> int:
    return int(model.actuator_history[number, 0])


def _parts(model: mujoco.MjModel, number: int) -> tuple[list[int], list[int]]:
    """Where MuJoCo's `history` has an actuator's times, and its controls. Before them are a number for the
    user, and the place of the newest."""
    first, size = int(model.actuator_historyadr[number]) + 2, _size(model, number)
    return list(range(first, first + size)), list(range(first + size, first + 2 * size))


def _read(model: mujoco.MjModel, data: mujoco.MjData, number: int, controls: NDArray[np.float64]) -> float:
    """What MuJoCo reads at time 0. controls: of the time steps before, the oldest first."""
    times = np.arange(-len(controls), 0.0)
    mujoco.mj_initCtrlHistory(model, data, number, times[:, None], controls[:, None])
    return float(np.ravel(mujoco.mj_readCtrl(model, data, number, 0.0, np.zeros((1, 1)), -1))[0])
