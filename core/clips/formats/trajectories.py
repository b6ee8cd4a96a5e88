"""Our own trajectories, as rollouts and evaluations store them: each episode is a clip."""

import json
from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np

from core.clips.formats.recording import Recording, at_the_origin, numbers
from core.errors import BadClips

NAME = "trajectory"
_FORMAT = "gaitway-trajectory"
_MOVED = ("hinge", "slide")


def is_one(about: Mapping[str, Any]) -> bool:
    return about.get("format") == _FORMAT


def recordings(file: Mapping[str, Any], about: Mapping[str, Any]) -> list[Recording]:
    """A clip an episode, with its velocities. The root is the free joint with the most joints behind it, up
    to the next free one: others are of things that the body meets. Raises BadClips."""
    try:
        joints = [
            (joint["type"], joint["name"], joint["qpos_start"], joint["qvel_start"])
            for joint in about["joints"]
        ]
        number = int(about["num_episodes"])
        return [_recording(file, f"episode_{episode}", joints) for episode in range(number)]
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise BadClips(f"The trajectory is not whole: {error}.") from None


def _recording(file: Mapping[str, Any], name: str, joints: list[tuple[Any, ...]]) -> Recording:
    time = numbers(file[f"{name}/time"], f"{name}/time", (1,))
    places, speeds = (numbers(file[f"{name}/{part}"], f"{name}/{part}") for part in ("qpos", "qvel"))
    root, moved = _body(joints)
    facts: dict[str, Any] = {}
    if root is None:
        facts["root_position"], facts["root_orientation"] = at_the_origin(len(places))
        facts["root_linear_velocity"] = facts["root_angular_velocity"] = np.zeros((len(places), 3))
    else:
        facts["root_position"] = places[:, root[2] : root[2] + 3]
        facts["root_orientation"] = places[:, root[2] + 3 : root[2] + 7]
        facts["root_linear_velocity"] = speeds[:, root[3] : root[3] + 3]
        facts["root_angular_velocity"] = speeds[:, root[3] + 3 : root[3] + 6]
    return Recording(
        name=name,
        joint_positions=places[:, [joint[2] for joint in moved]],
        joints=tuple(str(joint[1]) for joint in moved),
        joint_velocities=speeds[:, [joint[3] for joint in moved]],
        rate=None if len(time) < 2 else round(float(1 / np.median(np.diff(time))), 6),
        **facts,
    )


def _body(joints: list[tuple[Any, ...]]) -> tuple[tuple[Any, ...] | None, list[tuple[Any, ...]]]:
    """The root, None for a body that is fixed to the world, and its hinges and slides."""
    starts = [place for place, joint in enumerate(joints) if joint[0] == "free"]
    if not starts:
        return None, [joint for joint in joints if joint[0] in _MOVED]
    runs = [joints[start:end] for start, end in pairwise([*starts, len(joints)])]
    root, *others = max(runs, key=len)
    return root, [joint for joint in others if joint[0] in _MOVED]


def about_of(file: Mapping[str, Any], names: set[str]) -> Mapping[str, Any]:
    """The JSON text `about` of our own files; empty for others."""
    if "about" not in names:
        return {}
    try:
        about = json.loads(str(file["about"]))
    except ValueError:
        return {}
    return about if isinstance(about, dict) else {}
