"""Several cameras in one picture: their pictures from the left, with gaps and names."""

import copy
from collections.abc import Sequence
from contextlib import ExitStack
from types import TracebackType
from typing import Self

import mujoco
import numpy as np
from numpy.typing import NDArray

from core.rendering.camera import GAP_PIXELS, width_of
from core.rendering.frames import ModelFields, MujocoRenderer
from core.rendering.label import label
from core.rendering.scene import Floats, View

_GAP_COLOUR = (24, 26, 30)


class SideBySide:
    """Draws one model from several cameras; a single camera has neither gap nor name.

    cameras: numbers of the model's cameras, None for the one that follows the body. names: the text on
    their pictures. width, height: pixels of each picture. Holds GL contexts until its `with` block ends.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        view: View,
        cameras: Sequence[int | None],
        names: Sequence[str],
        *,
        width: int,
        height: int,
    ) -> None:
        self._width, self._height = width, height
        with ExitStack() as opened:
            # Each renderer changes its model, and its shadows reach as far as its camera sees.
            self._renderers = [
                opened.enter_context(
                    MujocoRenderer(copy.deepcopy(model), view, camera=camera, width=width, height=height)
                )
                for camera in cameras
            ]
            self._labels = [label(name, width=width, height=height) for name in names if len(names) > 1]
            self._opened = opened.pop_all()

    @property
    def gl_renderer(self) -> str:
        """The name that the GL driver reports; `llvmpipe` means software."""
        return self._renderers[0].gl_renderer

    def change_model(self, fields: ModelFields) -> None:
        """See MujocoRenderer."""
        for renderer in self._renderers:
            renderer.change_model(fields)

    def path(self, qpos: Floats) -> Floats:
        """Where the body is [N, 3] at each of the positions [N, nq]."""
        return self._renderers[0].path(qpos)

    def frame(self, qpos: Floats, look_at: Floats, target: Floats | None) -> NDArray[np.uint8]:
        """RGB [height, whole width, 3] of the positions qpos [nq]; look_at, target: as in MujocoRenderer."""
        pictures = [renderer.frame(qpos, look_at, target) for renderer in self._renderers]
        if len(pictures) == 1:
            return pictures[0]
        whole = np.empty((self._height, width_of(self._width, len(pictures)), 3), np.uint8)
        whole[:] = _GAP_COLOUR
        for place, (picture, name) in enumerate(zip(pictures, self._labels, strict=True)):
            left = place * (self._width + GAP_PIXELS)
            whole[:, left : left + self._width] = picture
            name.write_on(whole[:, left : left + self._width])
        return whole

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._opened.close()
