"""A video and its poster from episodes of motion."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import mujoco

from core.rendering.layout import TRACK, Layout, check_cameras, model_camera
from core.rendering.mp4 import CODEC, Mp4Writer, write_png
from core.rendering.picture_grid import Moment, PictureGrid
from core.rendering.request import RenderRequest, RenderResult
from core.rendering.scene import following_view
from core.rendering.timeline import EpisodeMotion, Shot, shots, smoothed

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
    request: RenderRequest, model: mujoco.MjModel, motions: Sequence[EpisodeMotion], *, gl_backend: str
) -> RenderResult:
    """Write the requested video and poster. Raises Rejected for unknown or repeated cameras.

    Frames go to the encoder one by one: memory does not grow with the video's length.
    """
    started = time.perf_counter()
    names = camera_names(model)
    check_cameras(request.cameras, names)
    cameras = [model_camera(camera, names) for camera in request.cameras]
    view = following_view(model, motions[0].qpos[0], request.tracked_body)
    num_at_once = min(request.episodes, len(motions))
    layout = Layout(request.width, request.height, len(cameras), num_at_once)
    size = {"width": layout.whole_width, "height": layout.whole_height}
    with (
        PictureGrid(
            model, view, cameras, [_called(camera, names) for camera in request.cameras], layout, request.show
        ) as grid,
        Mp4Writer(request.video, **size, fps=request.fps) as video,
    ):
        panes = [_moments(grid, model, motions[first::num_at_once], request) for first in range(num_at_once)]
        num_frames = max(map(len, panes))
        for number in range(num_frames):
            frame = grid.frame([_at(pane, number) for pane in panes])
            video.write(frame)
            if number == num_frames // 2:
                write_png(request.poster, frame)
        gl_renderer = grid.gl_renderer
    return RenderResult(
        gl_backend=gl_backend,
        gl_renderer=gl_renderer,
        cameras=request.cameras,
        show=request.show,
        frames=num_frames,
        seconds=num_frames / request.fps,
        **size,
        fps=request.fps,
        codec=CODEC,
        wall_s=time.perf_counter() - started,
    )


def _called(camera: str | int, names: Sequence[str]) -> str:
    """A picture's caption of its camera: its name, or its number where it has none or our own."""
    if isinstance(camera, str):
        return camera
    return f"camera {camera}" if names[camera] in ("", TRACK) else names[camera]


def _moments(
    grid: PictureGrid, model: mujoco.MjModel, motions: Sequence[EpisodeMotion], request: RenderRequest
) -> list[Moment]:
    """The frames of one place: these episodes one after another, a moment for each frame."""
    return [
        moment
        for shot in shots(model, motions, fps=request.fps, seconds=request.seconds)
        for moment in _of_shot(grid, shot, request.fps)
    ]


def _of_shot(grid: PictureGrid, shot: Shot, fps: int) -> Iterator[Moment]:
    path = smoothed(grid.path(shot.qpos), fps=fps, spread_s=_CAMERA_SPREAD_S)
    for row, (qpos, look_at) in enumerate(zip(shot.qpos, path, strict=True)):
        target, velocities, reference = (
            None if values is None else values[row]
            for values in (shot.target, shot.velocities, shot.reference)
        )
        yield Moment(qpos, look_at, target, shot.model, velocities, reference)


def _at(pane: Sequence[Moment], number: int) -> Moment:
    """A frame's moment; after the last one, that one."""
    return pane[number] if number < len(pane) else replace(pane[-1], has_ended=True)
