"""A replay of episodes: the scene and the poses that the page draws in three dimensions."""

import copy
from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from core.rendering.replay.materials import sky
from core.rendering.replay.poses import followed_bodies, frame_rows, moving_bodies, poses, target_body
from core.rendering.replay.replay_file import ReplayEpisode, replay_bytes
from core.rendering.replay.scene_file import scene_bytes
from core.rendering.scene import CameraView, Quality, following_view, prepare
from core.rendering.timeline import EpisodeMotion, Floats

# Pictures are drawn by the browser: these sizes of the model's buffers do not matter.
_UNUSED = Quality(samples=0, shadow_pixels=0)
_HAZE = (0.62, 0.74, 0.87)


def scene_of(model: mujoco.MjModel, qpos: Floats, tracked_body: int) -> bytes:
    """The model as binary glTF, in the colours of our videos. qpos: [nq], where an episode starts."""
    shown, view = _shown(model, qpos, tracked_body)
    return scene_bytes(shown, view)


def replay_of(
    model: mujoco.MjModel,
    motions: Sequence[EpisodeMotion],
    rewards: Sequence[NDArray[np.floating[Any]]],
    facts: Sequence[Mapping[str, Any]],
    tracked_body: int,
) -> bytes:
    """The file of these episodes, of which there is at least one. rewards: [T] each; facts: of each, for the
    header."""
    shown, view = _shown(model, motions[0].qpos[0], tracked_body)
    followed = followed_bodies(model, tracked_body)
    episodes = [
        ReplayEpisode(poses(model, motion, followed), _returns(motion, reward), fact)
        for motion, reward, fact in zip(motions, rewards, facts, strict=True)
    ]
    return replay_bytes(_about(shown, view, tracked_body), episodes)


def _shown(model: mujoco.MjModel, qpos: Floats, tracked_body: int) -> tuple[mujoco.MjModel, CameraView]:
    view = following_view(model, qpos, tracked_body)
    shown = copy.copy(model)
    prepare(shown, view, _UNUSED, width=0, height=0)
    return shown, view


def _returns(motion: EpisodeMotion, reward: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
    return np.concatenate([[0.0], np.cumsum(reward, dtype=np.float64)])[frame_rows(motion.time)]


def _sun(model: mujoco.MjModel) -> dict[str, Any]:
    """The model's first light from far away, or one like it."""
    directional = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    for light in range(model.nlight):
        if model.light_type[light] == directional and model.light_active[light]:
            direction, diffuse = model.light_dir[light], model.light_diffuse[light]
            return {"direction": direction.tolist(), "diffuse": diffuse.tolist()}
    return {"direction": [0.35, 0.35, -1.0], "diffuse": [0.7, 0.7, 0.7]}


def _about(model: mujoco.MjModel, view: CameraView, tracked_body: int) -> dict[str, Any]:
    return {
        "bodies": moving_bodies(model),
        "reference_bodies": followed_bodies(model, tracked_body),
        "tracked_body": tracked_body,
        "target_body": target_body(model),
        "view": {
            "azimuth": view.azimuth,
            "elevation": view.elevation,
            "distance": view.distance,
            "radius": view.radius,
            "top": view.top,
            "centre": view.centre.tolist(),
            "follows": view.body is not None,
            "fovy": float(model.vis.global_.fovy),
        },
        "sun": _sun(model),
        "sky": sky(model) or (_HAZE, _HAZE),
        "tendons": [
            {"rgba": model.tendon_rgba[tendon].tolist(), "width": float(model.tendon_width[tendon])}
            for tendon in range(model.ntendon)
        ],
    }
