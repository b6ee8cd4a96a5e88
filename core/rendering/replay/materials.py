"""The colours and textures of a model as glTF materials."""

from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from core.rendering.mp4 import png_bytes
from core.rendering.replay.glb import Glb
from core.rendering.replay.shapes import Floats

# Textures are thinned to at most this many pixels along a side.
_MOST_PIXELS = 512
_RGB = mujoco.mjtTextureRole.mjTEXROLE_RGB.value
_USER = mujoco.mjtTextureRole.mjTEXROLE_USER.value


@dataclass
class Materials:
    """The materials of one glTF, each added once."""

    model: mujoco.MjModel
    glb: Glb
    _known: dict[tuple[Any, ...], int] = field(default_factory=dict[tuple[Any, ...], int])

    def texture_of(self, material: int) -> int | None:
        """The number of the material's flat texture, if it has one."""
        texture = self._texture(material)
        is_flat = texture >= 0 and self.model.tex_type[texture] == mujoco.mjtTexture.mjTEXTURE_2D
        return texture if is_flat else None

    def add(self, rgba: Floats, material: int, *, with_texture: bool) -> int:
        """The glTF's number of a material of this colour [4].

        A texture that cannot be laid on (a cube's, or on a mesh without coordinates) gives its mean colour.
        """
        texture = self._texture(material)
        image = self.texture_of(material) if with_texture else None
        if texture >= 0 and image is None:
            mean = _pixels(self.model, texture).reshape(-1, 3).mean(axis=0) / 255
            rgba = np.concatenate([rgba[:3] * mean, rgba[3:]])
        key = (*np.round(rgba, 4).tolist(), image)
        if key not in self._known:
            self._known[key] = self._new(rgba, image)
        return self._known[key]

    def add_checker(self, dark: Floats, light: Floats) -> int:
        """A material of two by two tiles."""
        tiles = np.array([[dark, light], [light, dark]])
        image = self.glb.add("images", bufferView=self.glb.add_bytes(_png(tiles)), mimeType="image/png")
        sampler = self.glb.add("samplers", magFilter=9728, minFilter=9987, wrapS=10497, wrapT=10497)
        return self._material(np.ones(4), self.glb.add("textures", source=image, sampler=sampler))

    def _texture(self, material: int) -> int:
        if material < 0:
            return -1
        roles = self.model.mat_texid[material]
        return int(roles[_RGB] if roles[_RGB] >= 0 else roles[_USER])

    def _new(self, rgba: Floats, texture: int | None) -> int:
        if texture is None:
            return self._material(rgba, None)
        pixels = _pixels(self.model, texture)
        stride = -(-max(pixels.shape) // _MOST_PIXELS)
        content = png_bytes(np.ascontiguousarray(pixels[::stride, ::stride]))
        image = self.glb.add("images", bufferView=self.glb.add_bytes(content), mimeType="image/png")
        sampler = self.glb.add("samplers", magFilter=9729, minFilter=9987, wrapS=10497, wrapT=10497)
        return self._material(rgba, self.glb.add("textures", source=image, sampler=sampler))

    def _material(self, rgba: Floats, texture: int | None) -> int:
        colour = [*linear(rgba[:3]).tolist(), float(rgba[3])]
        surface: dict[str, Any] = {"baseColorFactor": colour, "metallicFactor": 0.0, "roughnessFactor": 0.8}
        if texture is not None:
            surface["baseColorTexture"] = {"index": texture}
        alpha = "BLEND" if rgba[3] < 1 else None
        return self.glb.add("materials", pbrMetallicRoughness=surface, alphaMode=alpha)


def linear(colour: Floats) -> Floats:
    """A colour [3] that screens show, as glTF's linear light (IEC 61966-2-1)."""
    return np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4)


def sky(model: mujoco.MjModel) -> tuple[list[float], list[float]] | None:
    """The colours [3] of the zenith and the horizon of the model's sky; None without one."""
    skies = np.flatnonzero(model.tex_type == mujoco.mjtTexture.mjTEXTURE_SKYBOX)
    if not len(skies):
        return None
    pixels = _pixels(model, int(skies[0])) / 255
    side = pixels.shape[1]
    if len(pixels) < 6 * side:  # One image for all sides.
        return pixels[0].mean(axis=0).tolist(), pixels[side // 2].mean(axis=0).tolist()
    # MuJoCo's order of the sides: right, left, up, down, front, back.
    return pixels[2 * side : 3 * side].mean(axis=(0, 1)).tolist(), pixels[side // 2].mean(axis=0).tolist()


def _pixels(model: mujoco.MjModel, texture: int) -> NDArray[np.uint8]:
    """RGB [height, width, 3]; grey for a texture of one channel."""
    height, width = int(model.tex_height[texture]), int(model.tex_width[texture])
    start, channels = int(model.tex_adr[texture]), int(model.tex_nchannel[texture])
    pixels = model.tex_data[start : start + height * width * channels].reshape(height, width, channels)
    return pixels[..., :3] if channels >= 3 else np.repeat(pixels[..., :1], 3, axis=-1)


def _png(tiles: Floats) -> bytes:
    return png_bytes(np.round(255 * tiles).astype(np.uint8))
