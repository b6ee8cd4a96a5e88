"""Episodes with all that was computed in them, as an HDF5 file (docs/neuroscience.md).

Episodes are written one after the other, so that no more than one is held in memory.
"""

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import h5py
import mujoco
import numpy as np
from numpy.typing import NDArray

from core.environments.info import Slice, Spaces
from core.environments.terms import array_slices
from core.environments.terms.describe import inventory
from core.environments.terms.metrics import UNITS
from core.environments.trajectory import Episode, FollowedClip

FORMAT, VERSION = "gaitway-recording", 1

_CHUNK_NUMBERS = 2**18
# Fast, and any reader of HDF5 has it; activations hardly get smaller by more effort.
_COMPRESSED: dict[str, Any] = {"compression": "gzip", "compression_opts": 1, "shuffle": True}


@dataclass(frozen=True)
class Quantity:
    """What an array holds. columns: what its second axis counts; unit: of all of its numbers, or None where
    each has one of its own."""

    unit: str | None
    meaning: str
    columns: str | None = None


# Of states, [T+1, …]: the start, and what each action led to.
_STATES: Mapping[str, Quantity] = {
    "qpos": Quantity(None, "positions", "qpos"),
    "qvel": Quantity(None, "velocities", "qvel"),
    "body_position": Quantity("m", "of each body in the world", "body"),
    "observation": Quantity(None, "what the policy saw", "observation"),
    "target": Quantity("m", "where the tracked body should go, in the world", "axis"),
    "command": Quantity("m/s, m/s, rad/s, m, rad", "forward, left, turn, height, pitch", "told"),
    "velocity": Quantity("m/s, m/s, rad/s", "forward, left and turn in the tracked body's frame", "told"),
    "clip": Quantity("1", "the clip that the body follows, a number of `names/clip`"),
    "clip_frame": Quantity("1", "the frame of that clip that the body is to be in"),
}
# Of actions, [T, …]; row t leads from state t to state t+1.
_ACTIONS: Mapping[str, Quantity] = {
    "action": Quantity(None, "what the policy did, each number in [-1, 1]", "action"),
    "reward": Quantity("1", "what it got for that"),
}
_ACTIVATION = Quantity("1", "after the layer's non-linearity; row t is of the observation of row t", "neuron")


def _metric(name: str) -> Quantity:
    if name.startswith("reward_"):
        return Quantity("1", "a term of the reward")
    if (unit := UNITS.get(name)) is not None:
        return Quantity(unit, "what a term measured")
    return Quantity("1", "the environment's own, in a unit of its own")


class RecordingWriter:
    """Writes the file, which gets its name when the block is over; after an exception there is none.

    model, spaces: say what the numbers are called. about: attributes of the file; texts and numbers, and
    anything else as JSON. num_episodes: how many it has so far.
    """

    def __init__(
        self,
        path: Path,
        model: mujoco.MjModel,
        spaces: Spaces,
        clips: Sequence[FollowedClip],
        about: Mapping[str, Any],
    ) -> None:
        self._path = path
        self._part = path.with_name(f".{path.name}.{os.getpid()}.part")
        self._model = model
        self._clips = clips
        self.num_episodes = 0
        # The first format whose attributes may be longer than 64 kB, as options of an environment are.
        self._file = h5py.File(self._part, "w", libver=("v108", "v108"))
        self._file.attrs.update({"format": FORMAT, "version": VERSION})
        self._file.attrs.update({name: _attribute(value) for name, value in about.items()})
        self._scales = dict[str, list[Any]]()
        has = inventory(model)
        for name, slices in (
            ("observation", spaces.observation),
            ("action", spaces.action),
            ("qpos", array_slices.qpos(has)),
            ("qvel", array_slices.qvel(has)),
        ):
            self._name(name, _names(slices), _units(slices))
        self._name("body", [model.body(i).name or f"body {i}" for i in range(1, model.nbody)])
        self._name("clip", [clip.name for clip in clips])
        if clips:
            self._file["names/clip"].attrs["num_frames"] = [clip.num_frames for clip in clips]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._file.attrs["num_episodes"] = self.num_episodes
            self._file.close()
            if kind is None:
                os.replace(self._part, self._path)
        finally:
            self._part.unlink(missing_ok=True)

    def add(self, episode: Episode, activations: Mapping[str, NDArray[np.float32]]) -> None:
        """Append an episode. activations: [T, size] of layers by their names."""
        group = self._file.create_group(f"episode_{self.num_episodes}")
        self.num_episodes += 1
        group.attrs.update({"terminated": episode.terminated, "num_steps": episode.num_steps})
        times = {
            "time": (episode.time, "since the episode's start"),
            "action_time": (episode.time[:-1], "at which each action was taken"),
        }
        for name, (seconds, meaning) in times.items():
            scale = group.create_dataset(name, data=seconds)
            scale.attrs.update({"unit": "s", "meaning": meaning})
            scale.make_scale(name)
        for name, values in self._states(episode).items():
            self._keep(group, name, values, _STATES[name], "time")
        for name, quantity in _ACTIONS.items():
            self._keep(group, name, getattr(episode, name), quantity, "action_time")
        for name, values in episode.metrics.items():
            self._keep(group, f"metrics/{name}", values, _metric(name), "action_time")
        for name, values in activations.items():
            self._keep(group, f"activations/{name}", values, _ACTIVATION, "action_time")

    def _states(self, episode: Episode) -> dict[str, NDArray[Any]]:
        states: dict[str, NDArray[Any]] = {
            name: values for name in _STATES if (values := getattr(episode, name, None)) is not None
        }
        states["body_position"] = body_positions(self._model, episode.qpos)
        if episode.reference_frame is not None:
            states["clip"], states["clip_frame"] = clips_at(self._clips, episode.reference_frame)
        return states

    def _keep(self, group: Any, name: str, values: NDArray[Any], quantity: Quantity, time: str) -> None:
        layout: dict[str, Any] = {}
        if values.size:
            rows = max(1, min(len(values), _CHUNK_NUMBERS * len(values) // values.size))
            layout = {"chunks": (rows, *values.shape[1:]), **_COMPRESSED}
        kept = group.create_dataset(name, data=values, **layout)
        kept.attrs["meaning"] = quantity.meaning
        if quantity.unit is not None:
            kept.attrs["unit"] = quantity.unit
        labels = [time, *filter(None, [quantity.columns]), "axis"]
        for dimension, label in zip(kept.dims, labels, strict=False):
            dimension.label = label
        kept.dims[0].attach_scale(group[time])
        for scale in self._scales.get(quantity.columns or "", ()):
            if values.ndim > 1 and len(scale) == values.shape[1]:
                kept.dims[1].attach_scale(scale)

    def _name(self, kind: str, names: Sequence[str], units: Sequence[str] | None = None) -> None:
        """Keep what the numbers of this kind are called, and their units, as scales of their dimension."""
        if not names:
            return
        text = h5py.string_dtype()
        self._scales[kind] = []
        for place, texts in (("names", names), ("units", units)):
            if texts is not None:
                scale = self._file.create_dataset(f"{place}/{kind}", data=np.array(texts, object), dtype=text)
                scale.make_scale(place)
                self._scales[kind].append(scale)


def clips_at(
    clips: Sequence[FollowedClip], reference_frame: NDArray[np.int32]
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """The number of the clip, and the frame of that clip, of each frame of the reference; [T] each."""
    first = np.array([clip.first_frame for clip in clips])
    clip = np.searchsorted(first, reference_frame, side="right") - 1
    return clip.astype(np.int32), (reference_frame - first[clip]).astype(np.int32)


def body_positions(model: mujoco.MjModel, qpos: NDArray[np.float32]) -> NDArray[np.float32]:
    """Where each body but the world is [T+1, bodies, 3], in m, in each of the positions [T+1, nq]."""
    data = mujoco.MjData(model)
    positions = np.empty((len(qpos), model.nbody - 1, 3), np.float32)
    for row, values in enumerate(qpos):
        data.qpos[:] = values
        mujoco.mj_kinematics(model, data)
        positions[row] = data.xpos[1:]
    return positions


def _names(slices: Iterable[Slice]) -> list[str]:
    """A name for each number: that of its slice, and its own there."""
    return [
        f"{part.name}/{component}"
        for part in slices
        for component in part.components or [str(number) for number in range(part.size)]
    ]


def _units(slices: Iterable[Slice]) -> list[str]:
    """The unit of each number: several where the numbers of a row differ, empty where it is not known."""
    return [part.unit or "" for part in slices for _ in range(part.size)]


def _attribute(value: Any) -> Any:
    return value if isinstance(value, str | int | float | bool) else json.dumps(value, sort_keys=True)
