"""How light falls on the ground, and how much of it a point gets, as in biorobot's light_escape."""

from importlib import import_module

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from numpy.typing import NDArray

from core.environments.brittle_star.options import LIGHT_MAP_RESOLUTION, LightEscapeOptions

_GROUND = "groundplane"
# The brightness of darkness in a picture, so that the star can be seen in it.
_DARKEST = 0.3


def light_map(options: LightEscapeOptions) -> NDArray[np.float32]:
    """Light in [0, 1], [rows, columns] as in a picture from above: x to the right, y up.

    It falls from 1 at the wall of least x to 0 at the opposite one. Patches, if any, become stronger with x,
    and begin behind the first fifth.
    """
    columns, rows = (LIGHT_MAP_RESOLUTION * size for size in options.arena_size)
    light = np.tile(np.linspace(1.0, 0.0, columns), (rows, 1))
    scale = options.light_perlin_noise_scale
    if scale == 0:
        return light.astype(np.float32)
    noise = import_module("biorobot.utils.noise").generate_perlin_noise_2d(
        shape=light.shape, res=(scale, scale), rng_key=options.light_seed
    )
    calm = columns // 5
    strength = np.concatenate([np.zeros(calm), np.linspace(0.0, 1.0, columns - calm)])
    light *= 1.0 + strength * (1.0 - 2.0 * noise)
    return ((light - light.min()) / np.ptp(light)).astype(np.float32)


def light_at(light: jax.Array, half_lengths: tuple[int, int], position: jax.Array) -> jax.Array:
    """The light [N] at points [N, 2] in metres, interpolated linearly between the pixels [rows, columns].

    A pixel's value is that of its corner of least x and greatest y. Beyond a wall, which arms may reach
    through, the light is that at the wall.
    """
    size = jnp.asarray(half_lengths, jnp.float32)
    across, up = jnp.moveaxis((position + size) / (2 * size), -1, 0)
    place = jnp.maximum(jnp.stack([1.0 - up, across]) * jnp.asarray(light.shape, jnp.float32)[:, None], 0.0)
    last = jnp.asarray(light.shape)[:, None] - 1
    low = jnp.clip(jnp.floor(place).astype(jnp.int32), 0, last)
    high = jnp.minimum(low + 1, last)
    part = place - low
    above = light[low[0], low[1]] * (1 - part[1]) + light[low[0], high[1]] * part[1]
    below = light[high[0], low[1]] * (1 - part[1]) + light[high[0], high[1]] * part[1]
    return above * (1 - part[0]) + below * part[0]


def show(model: mujoco.MjModel, light: NDArray[np.float32]) -> None:
    """Paint the light on the ground of the model (changed)."""
    texture = model.texture(_GROUND)
    start, height, width = (int(number[0]) for number in (texture.adr, texture.height, texture.width))
    pixels = model.tex_data[start : start + 3 * height * width].reshape(height, width, 3)
    pixels[...] = np.round((_DARKEST + (1 - _DARKEST) * light[..., None]) * pixels)
