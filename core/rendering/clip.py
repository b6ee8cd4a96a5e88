"""A video and its poster from episodes of motion."""

import time
from collections.abc import Sequence
from pathlib import Path

import mujoco

from core.rendering.camera import check_cameras, model_camera, width_of
from core.rendering.mp4 import CODEC, Mp4Writer, write_png
from core.rendering.request import RenderRequest, RenderResult
from core.rendering.scene import following_view
from core.rendering.side_by_side import SideBySide
from core.rendering.timeline import Motion, shots, smoothed

# Long enough that steps do not shake the camera, and short enough for it to keep up.
_CAMERA_SPREAD_S = 0.4


def load_model(path: Path) -> mujoco.MjModel:
    """A model from its compiled form (.mjb) or its XML. Raises ValueError if it is neither."""
    if path.suffix == ".mjb":
        return mujoco.MjModel.from_binary_path(str(path))
    return mujoco.MjModel.from_xml_path(str(path))


def camera_names(model: mujoco.MjModel) -> list[str]:
    """The names of the model's cameras in their order; empty for one without a name."""
    return [str(model.camera(number).name) for number in range(model.ncam)]


def draw(
    request: RenderRequest, model: mujoco.MjModel, motions: Sequence[Motion], *, gl_backend: str
) -> RenderResult:
    """Write the requested video and poster. Raises Rejected for unknown or repeated cameras.

    Frames go to the encoder one by one: memory does not grow with the video's length.
    """
    started = time.perf_counter()
    names = camera_names(model)
    check_cameras(request.cameras, names)
    cameras = [model_camera(camera, names) for camera in request.cameras]
    view = following_view(model, motions[0].qpos[0], request.tracked_body)
    size = {"width": request.width, "height": request.height}
    whole = {"width": width_of(request.width, len(cameras)), "height": request.height}
    sequence = list(shots(model, motions, fps=request.fps, seconds=request.seconds))
    num_frames = sum(len(shot.qpos) for shot in sequence)
    drawn = 0
    with (
        SideBySide(model, view, cameras, [str(camera) for camera in request.cameras], **size) as renderer,
        Mp4Writer(request.video, **whole, fps=request.fps) as video,
    ):
        for shot in sequence:
            renderer.change_model(shot.model)
            path = smoothed(renderer.path(shot.qpos), fps=request.fps, spread_s=_CAMERA_SPREAD_S)
            for row, (qpos, look_at) in enumerate(zip(shot.qpos, path, strict=True)):
                frame = renderer.frame(qpos, look_at, None if shot.target is None else shot.target[row])
                video.write(frame)
                if drawn == num_frames // 2:
                    write_png(request.poster, frame)
                drawn += 1
        gl_renderer = renderer.gl_renderer
    return RenderResult(
        gl_backend=gl_backend,
        gl_renderer=gl_renderer,
        cameras=request.cameras,
        frames=num_frames,
        seconds=num_frames / request.fps,
        **whole,
        fps=request.fps,
        codec=CODEC,
        wall_s=time.perf_counter() - started,
    )
