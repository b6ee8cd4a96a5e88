"""Episodes as numbers, and the file that holds them. Imports no JAX: the render process reads it."""

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

FORMAT = "gaitway-trajectory"
VERSION = 1

# name, shape, unit, meaning
_ARRAYS = (
    ("time", "[T+1]", "s", "since the episode's start"),
    ("qpos", "[T+1, nq]", "m, rad; rotations of free and ball joints as quaternions w x y z", "positions"),
    ("qvel", "[T+1, nv]", "m/s, rad/s", "velocities"),
    ("position", "[T+1, 3]", "m", "where the tracked body is in the world"),
    ("observation", "[T+1, observation_size]", "mixed", "what the policy saw"),
    ("action", "[T, action_size]", "1, each in [-1, 1]", "what it did; row t leads from state t to t+1"),
    ("reward", "[T]", "1", "what it got for that"),
)
_FIELDS = tuple(name for name, *_ in _ARRAYS)
# Fields of the model that are kept where episodes differ in them: a picture shows them.
ARENA = ("geom_pos", "geom_quat", "geom_size")
_OF_ARENA = (
    ("arena/geom_pos", "[ngeom, 3]", "m", "where this episode's geoms are, each in the frame of its body"),
    ("arena/geom_quat", "[ngeom, 4]", "1", "how they are turned in it, w x y z; where episodes differ in it"),
    ("arena/geom_size", "[ngeom, 3]", "m", "their sizes, as in MuJoCo"),
)
# Only of environments that have them.
_OPTIONAL = (
    ("target", "[T+1, 2 or 3]", "m", "where the tracked body should go, in the world"),
    (
        "command",
        "[T+1, 3 to 5]",
        "m/s, m/s, rad/s, m, rad",
        "what it is told: forward, left, turn; the height and the pitch, if it is told those",
    ),
    (
        "velocity",
        "[T+1, 3]",
        "m/s, m/s, rad/s",
        "what it does: forward, left and turn in the tracked body's frame; with a command",
    ),
    (
        "reference_frame",
        "[T+1]",
        "1",
        "the frame of the reference that the body is to be in, counted over all of `clips`",
    ),
    ("reference", "[T+1, nq]", "m, rad; rotations as in qpos", "the positions of that frame"),
)


@dataclass(frozen=True)
class FollowedClip:
    """A clip as a body follows it, a frame for each action. first_frame: its place among those of all."""

    name: str
    first_frame: int
    num_frames: int


@dataclass(frozen=True)
class Episode:
    """One episode of T steps; arrays as `_ARRAYS` lists them, float32 but for `time`.

    arena: `ARENA` [ngeom, 3 or 4], where episodes differ in the geoms of their arena.

    terminated: the environment ended it; otherwise it was cut off. metrics: [T] by name. target, command,
    velocity, reference_frame, reference: see `_OPTIONAL`; None if the environment has none.
    """

    time: NDArray[np.float64]
    qpos: NDArray[np.float32]
    qvel: NDArray[np.float32]
    position: NDArray[np.float32]
    observation: NDArray[np.float32]
    action: NDArray[np.float32]
    reward: NDArray[np.float32]
    terminated: bool
    metrics: Mapping[str, NDArray[np.float32]] = field(default_factory=dict[str, Any])
    target: NDArray[np.float32] | None = None
    command: NDArray[np.float32] | None = None
    velocity: NDArray[np.float32] | None = None
    reference_frame: NDArray[np.int32] | None = None
    reference: NDArray[np.float32] | None = None
    arena: Mapping[str, NDArray[np.float32]] = field(default_factory=dict[str, Any])

    @property
    def num_steps(self) -> int:
        return len(self.reward)

    @property
    def duration_s(self) -> float:
        return float(self.time[-1] - self.time[0])


def not_finite(episode: Episode) -> tuple[int, str] | None:
    """The first step that left a number that is not finite, 0 being the start, and of which quantity."""
    found: list[tuple[int, str]] = []
    # In the order in which, within a step, one spoils the next.
    for name in ("action", "qvel", "qpos", "observation", "reward"):
        rows: NDArray[np.float32] = getattr(episode, name)
        bad = np.flatnonzero(~np.isfinite(rows).reshape(len(rows), -1).all(axis=1))
        if len(bad):
            found.append((int(bad[0]) + (name in ("action", "reward")), name))
    return min(found, key=lambda one: one[0], default=None)


@dataclass(frozen=True)
class Trajectory:
    """Episodes, and a description of their numbers; see `describe`."""

    episodes: Sequence[Episode]
    about: Mapping[str, Any]


def describe(model: mujoco.MjModel, /, **facts: Any) -> dict[str, Any]:
    """The file's own description: arrays with shapes and units, joints and actuators by name, and `facts`."""
    arrays = _described(*_ARRAYS)
    arrays["episode_<i>/terminated"] = {"shape": "[]", "unit": "", "meaning": "ended by the environment"}
    arrays["episode_<i>/metrics/<name>"] = {"shape": "[T]", "unit": "", "meaning": "the environment's own"}
    joints = [
        {
            "name": str(joint.name),
            "type": mujoco.mjtJoint(int(joint.type[0])).name.removeprefix("mjJNT_").lower(),
            "qpos_start": int(joint.qposadr[0]),
            "qvel_start": int(joint.dofadr[0]),
        }
        for joint in (model.joint(number) for number in range(model.njnt))
    ]
    actuators = [str(model.actuator(number).name) for number in range(model.nu)]
    return {
        "format": FORMAT,
        "version": VERSION,
        **facts,
        "arrays": arrays,
        "joints": joints,
        "actuators": actuators,
    }


def _described(*rows: tuple[str, str, str, str]) -> dict[str, dict[str, str]]:
    return {
        f"episode_<i>/{name}": {"shape": shape, "unit": unit, "meaning": meaning}
        for name, shape, unit, meaning in rows
    }


def save(path: Path, trajectory: Trajectory) -> None:
    """Write one .npz, whole or not at all; equal trajectories give equal bytes. `about` is JSON text."""
    about: dict[str, Any] = {**trajectory.about, "num_episodes": len(trajectory.episodes)}
    optional = [
        row for row in _OPTIONAL if any(getattr(one, row[0]) is not None for one in trajectory.episodes)
    ]
    about["arrays"] = {**about["arrays"], **_described(*optional)}
    if any(episode.arena for episode in trajectory.episodes):
        about["arrays"] = {**about["arrays"], **_described(*_OF_ARENA)}
    contents: dict[str, Any] = {"about": np.array(json.dumps(about, sort_keys=True))}
    for number, episode in enumerate(trajectory.episodes):
        prefix = f"episode_{number}/"
        contents |= {prefix + name: getattr(episode, name) for name in _FIELDS}
        contents[prefix + "terminated"] = np.array(episode.terminated)
        contents |= {
            prefix + name: values for name, *_ in optional if (values := getattr(episode, name)) is not None
        }
        contents |= {f"{prefix}arena/{name}": values for name, values in sorted(episode.arena.items())}
        contents |= {f"{prefix}metrics/{name}": values for name, values in sorted(episode.metrics.items())}
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with part.open("wb") as file:
            np.savez_compressed(file, **contents)
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def load(path: Path) -> Trajectory:
    """Read the file of `save`. Raises ValueError if the file is something else."""
    with np.load(path, allow_pickle=False) as file:
        if "about" not in file.files:
            raise ValueError(f"{path.name} is not a trajectory: it has no `about`.")
        about: dict[str, Any] = json.loads(str(file["about"]))
        if (about.get("format"), about.get("version")) != (FORMAT, VERSION):
            raise ValueError(f"{path.name} is not a {FORMAT} of version {VERSION}.")
        episodes = [_episode(file, f"episode_{number}/") for number in range(int(about["num_episodes"]))]
    return Trajectory(episodes, about)


def _episode(file: Any, prefix: str) -> Episode:
    metrics = prefix + "metrics/"
    return Episode(
        **{name: file[prefix + name] for name in _FIELDS},
        terminated=bool(file[prefix + "terminated"]),
        metrics={name.removeprefix(metrics): file[name] for name in file.files if name.startswith(metrics)},
        **{name: file[place] for name, *_ in _OPTIONAL if (place := prefix + name) in file.files},
        arena={name: file[place] for name in ARENA if (place := f"{prefix}arena/{name}") in file.files},
    )


def summary(trajectory: Trajectory) -> dict[str, Any]:
    """Returns, lengths and speeds as JSON. Speed: m/s along x from an episode's start to its end.

    `forward_speed_m_s` is that of all episodes together; `mean` and `std` weigh all episodes equally.
    """
    rows = [_summary(episode) for episode in trajectory.episodes]
    columns = ("return", "num_steps", "duration_s", "distance_m", "forward_speed_m_s")
    return {
        "num_episodes": len(rows),
        "forward_speed_m_s": sum(row["distance_m"] for row in rows) / sum(row["duration_s"] for row in rows),
        "num_terminated": sum(row["terminated"] for row in rows),
        "mean": {name: float(np.mean([row[name] for row in rows])) for name in columns},
        "std": {name: float(np.std([row[name] for row in rows])) for name in columns},
        "episodes": rows,
    }


def _summary(episode: Episode) -> dict[str, Any]:
    forward = float(episode.position[-1, 0]) - float(episode.position[0, 0])
    return {
        "return": float(episode.reward.sum(dtype=np.float64)),
        "num_steps": episode.num_steps,
        "duration_s": episode.duration_s,
        "distance_m": forward,
        "forward_speed_m_s": forward / episode.duration_s,
        "terminated": episode.terminated,
    }
