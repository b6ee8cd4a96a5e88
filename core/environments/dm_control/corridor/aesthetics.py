"""How ground and sky are drawn. No physics depends on it."""

from pathlib import Path

import mujoco

from core.environments import optional_packages
from core.environments.dm_control.corridor.options import Aesthetic
from core.installation import to_install

# A group that is not drawn.
HIDDEN = 3
# As dm_control has it: where the six sides of the sky are in its picture.
_SKY_LAYOUT = ".U..LFRB.D.."


def draw(spec: mujoco.MjSpec, aesthetic: Aesthetic, *, squares_per_m: float) -> None:
    """Draw the ground, and `outdoor_natural`'s sky. dm_control's `default` is as it was composed.

    Raises JobFailed("bad_model") where dm_control, which brings the pictures, is not installed.
    """
    match aesthetic:
        case "checkered":
            _pave(spec, squares_per_m=squares_per_m)
        case "outdoor_natural":
            _plant(spec)
        case "default":
            pass


def _pave(spec: mujoco.MjSpec, *, squares_per_m: float) -> None:
    """Draw squares on the ground, so that a picture shows the walker's speed."""
    spec.add_texture(
        name="ground",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=[0.2, 0.2, 0.2],
        rgb2=[0.8, 0.8, 0.8],
        width=100,
        height=100,
    )
    repeats = squares_per_m / 2
    material = spec.add_material(name="ground", texrepeat=[repeats, repeats], texuniform=True)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "ground"
    _cover_the_ground(spec)


def _plant(spec: mujoco.MjSpec) -> None:
    """Draw dm_control's grass and sky."""
    for texture in list(spec.textures):
        if texture.type == mujoco.mjtTexture.mjTEXTURE_SKYBOX:
            spec.delete(texture)
    pictures = _pictures()
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        file=str(pictures / "OutdoorSkybox2048.png"),
        gridsize=[3, 4],
        gridlayout=list(_SKY_LAYOUT),
    )
    grass = str(pictures / "OutdoorGrassFloorD.png")
    spec.add_texture(name="ground", type=mujoco.mjtTexture.mjTEXTURE_2D, file=grass)
    material = spec.add_material(name="ground", texuniform=True)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "ground"
    _cover_the_ground(spec)


def _cover_the_ground(spec: mujoco.MjSpec) -> None:
    for geom in spec.geoms:
        is_ground = geom.parent.name == "ground"
        if is_ground or (geom.parent.name == "world" and geom.group != HIDDEN):
            geom.material, geom.rgba = "ground", [1, 1, 1, 1]


def _pictures() -> Path:
    brings, install = "The aesthetic's pictures come with dm_control", to_install("dm-control")
    path = "locomotion/arenas/assets/outdoor_natural"
    return optional_packages.file("dm_control", path, brings=brings, install=install)
