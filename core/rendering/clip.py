"""A video and its poster from episodes of motion."""

import time
from collections.abc import Sequence
from pathlib import Path

import mujoco

from core.rendering.camera import model_camera
from core.rendering.frames import MujocoRenderer
from core.rendering.mp4 import CODEC, Mp4Writer, write_png
from core.rendering.request import RenderRequest, RenderResult
from core.rendering.scene import following_view
from core.rendering.timeline import Motion, shots, smoothed

# Long enough that steps do not shake the camera, short enough that it keeps up.
_CAMERA_SPREAD_S = 0.4


def load_model(path: Path) -> mujoco.MjModel:
    """A model from its compiled form (.mjb) or its XML. Raises ValueError where it is neither."""
    if path.suffix == ".mjb":
        return mujoco.MjModel.from_binary_path(str(path))
    return mujoco.MjModel.from_xml_path(str(path))


def camera_names(model: mujoco.MjModel) -> list[str]:
    """The names of the model's cameras in their order; empty for one without a name."""
    return [str(model.camera(number).name) for number in range(model.ncam)]


def draw(
    request: RenderRequest, model: mujoco.MjModel, motions: Sequence[Motion], *, gl_backend: str
) -> RenderResult:
    """Write the video and the poster that are asked for. Raises Rejected for an unknown camera.

    Frames go to the encoder one by one: memory does not grow with the video's length.
    """
    started = time.perf_counter()
    camera = model_camera(request.camera, camera_names(model))
    view = following_view(model, motions[0].qpos[0], request.tracked_body)
    size = {"width": request.width, "height": request.height}
    sequence = list(shots(model, motions, fps=request.fps, seconds=request.seconds))
    num_frames = sum(len(shot.qpos) for shot in sequence)
    drawn = 0
    with (
        MujocoRenderer(model, view, camera=camera, **size) as renderer,
        Mp4Writer(request.video, **size, fps=request.fps) as video,
    ):
        for shot in sequence:
            path = smoothed(renderer.path(shot.qpos), fps=request.fps, spread_s=_CAMERA_SPREAD_S)
            for qpos, look_at in zip(shot.qpos, path, strict=True):
                frame = renderer.frame(qpos, look_at)
                video.write(frame)
                if drawn == num_frames // 2:
                    write_png(request.poster, frame)
                drawn += 1
        gl_renderer = renderer.gl_renderer
    return RenderResult(
        gl_backend=gl_backend,
        gl_renderer=gl_renderer,
        camera=request.camera,
        frames=num_frames,
        seconds=num_frames / request.fps,
        **size,
        fps=request.fps,
        codec=CODEC,
        wall_s=time.perf_counter() - started,
    )
