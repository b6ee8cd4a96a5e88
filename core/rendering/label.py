"""A few words on a picture, in MuJoCo's font."""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

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
