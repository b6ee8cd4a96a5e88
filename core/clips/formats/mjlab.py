"""NPZ of mjlab, BeyondMimic and holosoma: `fps`, `joint_pos`, and each body in the world."""

from collections.abc import Mapping
from typing import Any

from core.clips.formats.recording import Recording, number, numbers, strings
from core.errors import BadClips

NAME = "mjlab"


def is_one(names: set[str]) -> bool:
    return "joint_pos" in names


def recordings(file: Mapping[str, Any], names: set[str]) -> list[Recording]:
    """The file's one clip. Raises BadClips.

    joint_pos is [T, J], with the root in the first body that is not the world; or [T, 7 + J] with the root's
    position and orientation w x y z in front.
    """
    joints = strings(file["joint_names"], "joint_names") if "joint_names" in names else None
    positions = numbers(file["joint_pos"], "joint_pos")
    rate = number(file["fps"], "fps") if "fps" in names else None
    root: dict[str, Any] = {}
    if {"body_pos_w", "body_quat_w"} <= names:
        root = _root(file, names)
    if joints is not None:
        if positions.shape[1] not in (len(joints), len(joints) + 7):
            raise BadClips(
                f"`joint_pos` has {positions.shape[1]} columns, but `joint_names` has {len(joints)} names: "
                "it has a column a joint, with or without the root's seven in front."
            )
        if positions.shape[1] == len(joints) + 7:
            root = {"body_positions": root.get("body_positions")}
    return [Recording(name="", joint_positions=positions, joints=joints, rate=rate, **root)]


def _root(file: Mapping[str, Any], names: set[str]) -> dict[str, Any]:
    places = numbers(file["body_pos_w"], "body_pos_w", (3,))
    turns = numbers(file["body_quat_w"], "body_quat_w", (3,))
    if turns.shape != (*places.shape[:2], 4) or places.shape[1:2] == (0,) or places.shape[2] != 3:
        shapes = f"{list(places.shape)} and {list(turns.shape)}"
        raise BadClips(
            f"`body_pos_w` and `body_quat_w` have the shapes {shapes}, not [T, B, 3] and [T, B, 4]."
        )
    bodies = strings(file["body_names"], "body_names") if "body_names" in names else ()
    root = 1 if bodies[:1] == ("world",) and places.shape[1] > 1 else 0
    return {
        "root_position": places[:, root],
        "root_orientation": turns[:, root],
        "body_positions": places[:, root:],
    }
