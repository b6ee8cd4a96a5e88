"""Several cameras and episodes in one picture, with gaps and words that say which is which."""

import copy
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Self

import mujoco
import numpy as np
from numpy.typing import NDArray

from core.rendering.frames import ModelFields, MujocoRenderer
from core.rendering.layout import Layout
from core.rendering.request import Overlay
from core.rendering.scene import CameraView, Floats

# Pixels from the upper left corner to the words, and of the dark margin around them.
_OFFSET, _MARGIN = 8, 6
# The share of its brightness that the background keeps, so that white words are legible on a white sky.
_SHADE = 0.45
_LINE_PIXELS = 64
_EMPTY = "<mujoco><visual><global offwidth='{width}' offheight='{height}'/></visual></mujoco>"


@dataclass(frozen=True)
class Label:
    """ink: [rows, columns] from 0 to 1, how white each pixel of the words is, with a margin."""

    ink: NDArray[np.float32]

    def write_on(self, picture: NDArray[np.uint8]) -> None:
        """Write into the upper left corner of RGB [height, width, 3]; what does not fit is cut off."""
        place = picture[_OFFSET : _OFFSET + self.ink.shape[0], _OFFSET : _OFFSET + self.ink.shape[1]]
        ink = self.ink[: place.shape[0], : place.shape[1], None]
        place[:] = np.round(place * _SHADE * (1 - ink) + 255 * ink)


def label(text: str, *, width: int, height: int) -> Label:
    """Words for a picture of this size, drawn in a separate GL context: MUJOCO_GL must be set."""
    model = mujoco.MjModel.from_xml_string(_EMPTY.format(width=width, height=_LINE_PIXELS))
    scale = mujoco.mjtFontScale.mjFONTSCALE_150 if height >= 360 else mujoco.mjtFontScale.mjFONTSCALE_100
    gl = mujoco.GLContext(width, _LINE_PIXELS)
    try:
        gl.make_current()
        context = mujoco.MjrContext(model, scale.value)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, context)
        line = mujoco.MjrRect(0, 0, width, _LINE_PIXELS)
        mujoco.mjr_rectangle(line, 0.0, 0.0, 0.0, 1.0)
        mujoco.mjr_text(mujoco.mjtFont.mjFONT_NORMAL, text, context, 0.02, 0.5, 1.0, 1.0, 1.0)
        pixels = np.empty((_LINE_PIXELS, width, 3), np.uint8)
        mujoco.mjr_readPixels(pixels, None, line, context)
        context.free()
    finally:
        gl.free()
    ink = pixels[::-1, :, 0].astype(np.float32) / np.float32(255)
    rows, columns = np.flatnonzero(ink.any(axis=1)), np.flatnonzero(ink.any(axis=0))
    if not len(rows):
        return Label(np.zeros((0, 0), np.float32))
    return Label(np.pad(ink[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1], _MARGIN))


_GAP_COLOUR = (24, 26, 30)
# The share of its brightness that an episode keeps after its end.
_ENDED = 0.5


@dataclass(frozen=True)
class Moment:
    """One moment of an episode. qpos: [nq]; look_at, target, velocities, reference: as in
    MujocoRenderer. model: the fields of the model that the episode has for itself.

    has_ended: the episode ended before, and this is its last state.
    """

    qpos: Floats
    look_at: Floats
    target: Floats | None = None
    model: ModelFields = field(default_factory=dict[str, Any])
    velocities: Floats | None = None
    reference: Floats | None = None
    has_ended: bool = False


class PictureGrid:
    """Draws one model from several cameras, in as many episodes as the layout has.

    cameras: numbers of the model's cameras, None for the one that follows the body. names: the text on
    their pictures, where there are several. Holds GL contexts until its `with` block ends.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        view: CameraView,
        cameras: Sequence[int | None],
        names: Sequence[str],
        layout: Layout,
        show: Sequence[Overlay] = (),
    ) -> None:
        self._layout = layout
        size = {"width": layout.width, "height": layout.height}
        with ExitStack() as opened:
            # Each renderer changes its model, and its shadows reach as far as its camera sees.
            self._renderers = [
                opened.enter_context(
                    MujocoRenderer(copy.deepcopy(model), view, camera=camera, show=show, **size)
                )
                for camera in cameras
            ]
            self._labels = {
                (episode, camera): label(words, **size)
                for episode in range(layout.num_episodes)
                for camera, name in enumerate(names)
                if (words := _words(layout, episode, name))
            }
            self._opened = opened.pop_all()

    @property
    def gl_renderer(self) -> str:
        """The name that the GL driver reports; `llvmpipe` means software."""
        return self._renderers[0].gl_renderer

    def path(self, qpos: Floats) -> Floats:
        """Where the body is [N, 3] at each of the positions [N, nq]."""
        return self._renderers[0].path(qpos)

    def frame(self, moments: Sequence[Moment]) -> NDArray[np.uint8]:
        """RGB [whole height, whole width, 3] of one moment of each episode."""
        layout = self._layout
        whole = np.empty((layout.whole_height, layout.whole_width, 3), np.uint8)
        whole[:] = _GAP_COLOUR
        for episode, moment in enumerate(moments):
            for camera, renderer in enumerate(self._renderers):
                renderer.change_model(moment.model)
                picture = renderer.frame(
                    moment.qpos, moment.look_at, moment.target, moment.velocities, moment.reference
                )
                place = whole[layout.place(episode, camera)]
                place[:] = picture * _ENDED if moment.has_ended else picture
                if words := self._labels.get((episode, camera)):
                    words.write_on(place)
        return whole

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._opened.close()


def _words(layout: Layout, episode: int, camera: str) -> str:
    """Which episode and camera a picture shows; nothing where there is but one."""
    which = [f"episode {episode}"] if layout.num_episodes > 1 else []
    return ", ".join([*which, *([camera] if layout.num_cameras > 1 else [])])
