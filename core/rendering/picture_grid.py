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
from core.rendering.label import label
from core.rendering.layout import Layout
from core.rendering.overlays import Overlay
from core.rendering.scene import Floats, View

_GAP_COLOUR = (24, 26, 30)
# The share of its brightness that an episode keeps after its end.
_ENDED = 0.5


@dataclass(frozen=True)
class Moment:
    """One moment of an episode. qpos: [nq]; look_at, target: as in MujocoRenderer. model: the fields of the
    model that the episode has for itself.

    has_ended: the episode ended before, and this is its last state.
    """

    qpos: Floats
    look_at: Floats
    target: Floats | None = None
    model: ModelFields = field(default_factory=dict[str, Any])
    has_ended: bool = False


class PictureGrid:
    """Draws one model from several cameras, in as many episodes as the layout has.

    cameras: numbers of the model's cameras, None for the one that follows the body. names: the text on
    their pictures, where there are several. Holds GL contexts until its `with` block ends.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        view: View,
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
                picture = renderer.frame(moment.qpos, moment.look_at, moment.target)
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
