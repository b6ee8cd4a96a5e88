"""A request to the render process, and its answer; both travel as JSON."""

from pathlib import Path
from typing import Literal

from core.documents import Stored

# MuJoCo's flags of these names: joints, points of contact, the centre of mass, bodies one can see through.
Overlay = Literal["joints", "contacts", "centre_of_mass", "transparent"]


FailureReason = Literal["no_gl", "bad_request", "crashed", "timeout"]


class RenderRequest(Stored):
    """A video of a stored trajectory.

    trajectory: a file of `core.environments.trajectory`. model: the compiled model (.mjb) or its XML.
    tracked_body: number of the body that the camera `track` follows. cameras: side by side, from the left.
    show: what is drawn besides the body. reference: draw the clip that it follows, if any. episodes: how many
    are shown at the same time; 1: one after another.
    width, height: pixels of each picture, both even. seconds: the longest that the video may be.
    poster: a PNG of the frame in the middle.
    """

    trajectory: Path
    model: Path
    tracked_body: int
    video: Path
    poster: Path
    cameras: list[str | int] = ["track"]
    show: list[Overlay] = []
    reference: bool = True
    episodes: int = 1
    width: int = 640
    height: int = 480
    fps: int = 30
    seconds: float = 10.0


class RenderResult(Stored):
    """Facts about a video, for its artifact's metadata.

    width, height: pixels of the whole video. wall_s: how long the drawing took.
    """

    gl_backend: str
    gl_renderer: str
    cameras: list[str | int]
    show: list[Overlay] = []
    frames: int
    seconds: float
    width: int
    height: int
    fps: int
    codec: str
    wall_s: float


class RenderFailure(Stored):
    """Why there is no video."""

    reason: FailureReason
    message: str
