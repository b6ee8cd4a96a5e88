"""Which of a model's geoms and sites are seen: those of MuJoCo's first three groups that have a colour."""

from collections.abc import Iterator

import mujoco
import numpy as np

from core.rendering.replay.shapes import Floats, Part

_SHOWN_GROUPS = 3
# A geom of this colour has that of its material.
_UNSET = (0.5, 0.5, 0.5, 1.0)


def parts(model: mujoco.MjModel) -> Iterator[Part]:
    """The geoms, then the sites; the node of geom 3 is named `geom_3`."""
    for geom in range(model.ngeom):
        rgba = _colour(model, model.geom_rgba[geom], int(model.geom_matid[geom]))
        if model.geom_group[geom] < _SHOWN_GROUPS and rgba[3] > 0:
            yield Part(
                f"geom_{geom}",
                mujoco.mjtGeom(int(model.geom_type[geom])),
                int(model.geom_dataid[geom]),
                np.array(model.geom_size[geom]),
                int(model.geom_bodyid[geom]),
                np.array(model.geom_pos[geom]),
                np.array(model.geom_quat[geom]),
                rgba,
                int(model.geom_matid[geom]),
            )
    for site in range(model.nsite):
        rgba = _colour(model, model.site_rgba[site], int(model.site_matid[site]))
        if model.site_group[site] < _SHOWN_GROUPS and rgba[3] > 0:
            yield Part(
                f"site_{site}",
                mujoco.mjtGeom(int(model.site_type[site])),
                -1,
                np.array(model.site_size[site]),
                int(model.site_bodyid[site]),
                np.array(model.site_pos[site]),
                np.array(model.site_quat[site]),
                rgba,
                int(model.site_matid[site]),
            )


def _colour(model: mujoco.MjModel, own: Floats, material: int) -> Floats:
    """[4]: its own colour; its material's where it has not been given one."""
    if material >= 0 and np.allclose(own, _UNSET):
        return np.array(model.mat_rgba[material], float)
    return np.array(own, float)
