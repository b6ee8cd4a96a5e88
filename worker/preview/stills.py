"""Draws a body at the start of its first episode, from each camera. Set MUJOCO_GL before you import this."""

import copy
from pathlib import Path

from core.environments.rollout import initial_positions
from core.jobs.spec import EnvironmentSpec, RolloutSpec, ZeroPolicy
from core.previews.record import PreviewRequest
from core.rendering.clip import camera_names
from core.rendering.frames import MujocoRenderer
from core.rendering.layout import model_camera
from core.rendering.mp4 import write_png
from core.rendering.scene import following_view
from worker.protocol import Task
from worker.training.built_environment import build_environment


def draw(request: PreviewRequest, folder: Path) -> None:
    """Write `0.png`, `1.png`, … into the folder, one for each camera.

    The user's own model, if the options name one, is there as `model`, clips as
    `clips-0.npz`, …. Raises JobFailed if no job could use
    this body.
    """
    spec = RolloutSpec(
        environment=EnvironmentSpec(id=request.environment, options=request.options), policy=ZeroPolicy()
    )
    model = str(folder / "model") if request.model else None
    clips = {file_id: str(folder / f"clips-{number}.npz") for number, file_id in enumerate(request.clips)}
    environment = build_environment(
        Task(job_id="", attempt=0, spec=spec, device="cpu", model=model, clips=clips)
    ).environment
    qpos, target = initial_positions(environment, spec.seed)
    view = following_view(environment.model, qpos, environment.tracked_body)
    names = camera_names(environment.model)
    for number, camera in enumerate(request.cameras):
        with MujocoRenderer(
            copy.copy(environment.model),
            view,
            camera=model_camera(camera, names),
            width=request.width,
            height=request.height,
            show=request.show,
        ) as renderer:
            write_png(folder / f"{number}.png", renderer.frame(qpos, target=target))
