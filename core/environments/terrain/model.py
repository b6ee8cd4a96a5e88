"""A terrain's boxes in a model, hidden below its floor: each environment has them where its layout says."""

import mujoco
import numpy as np

from core.environments.terms.describe import is_level_plane, touchable
from core.environments.terms.terrain import BOX, Terrain
from core.environments.terrain.layouts import Layout, num_upright
from core.errors import JobFailed
from core.reasons import Reason

# As in the floor, so that a foot feels no difference.
_LIKE_THE_FLOOR = (
    "conaffinity",
    "condim",
    "contype",
    "friction",
    "gap",
    "margin",
    "priority",
    "solimp",
    "solmix",
    "solref",
)
_COLOURS = ((0.66, 0.62, 0.55, 1.0), (0.58, 0.60, 0.57, 1.0), (0.60, 0.55, 0.50, 1.0))
# MuJoCo's numbers of the size of what is drawn.
_EXTENT = ("center", "extent", "meansize")


def add_boxes(spec: mujoco.MjSpec, model: mujoco.MjModel, terrain: Terrain) -> None:
    """Add the boxes to the world. model: compiled from the specification.

    Raises JobFailed("bad_model") where its ground is not one level plane.
    """
    floor = spec.geoms[floor_of(model)]
    hidden = Layout.unused(terrain)
    for number, (place, size, turn) in enumerate(
        zip(hidden.places, hidden.sizes, hidden.quaternions(), strict=True)
    ):
        kind = 2 if number >= num_upright(terrain) else number % 2
        box = spec.worldbody.add_geom(
            name=f"{BOX}{number}", type=mujoco.mjtGeom.mjGEOM_BOX, pos=place, size=size, quat=turn
        )
        box.rgba = _COLOURS[kind]
        for name in _LIKE_THE_FLOOR:
            setattr(box, name, getattr(floor, name))
    for name in _EXTENT:
        setattr(spec.stat, name, getattr(model.stat, name))


def boxes_of(model: mujoco.MjModel) -> np.ndarray:
    """The numbers of the terrain's boxes, in their order."""
    return np.array([geom for geom in range(model.ngeom) if model.geom(geom).name.startswith(BOX)], int)


def floor_of(model: mujoco.MjModel) -> int:
    """The number of the one plane that is all of the world that can be touched."""
    _, fixed = touchable(model)
    ground = [geom for geom in fixed if not model.geom(geom).name.startswith(BOX)]
    if len(ground) == 1 and is_level_plane(model, ground[0]):
        return int(ground[0])
    names = ", ".join(repr(model.geom(geom).name) for geom in ground[:3]) or "nothing"
    raise JobFailed(
        Reason.BAD_MODEL,
        "A terrain needs a world of which one level plane can be touched and nothing else; in this model "
        f"it is {names}.",
    )
