"""Which geoms of a model can touch: MuJoCo's own filter, which no state changes.

Source: MuJoCo's documentation, Computation, "Collision detection", "Selection".
"""

from collections.abc import Iterator

import mujoco
import numpy as np


def touching_geoms(model: mujoco.MjModel) -> Iterator[tuple[int, int]]:
    """Pairs of geoms, the lower number first, without those that the model lists as pairs."""
    bodies, types, affinities = model.geom_bodyid, model.geom_contype, model.geom_conaffinity
    welds = model.body_weldid[bodies]
    for one in range(model.ngeom):
        later = slice(one + 1, None)
        asks = (types[one] & affinities[later]) | (types[later] & affinities[one])
        # The world of a user's model may have thousands of geoms: those pairs are not looked at one by one.
        for other in np.flatnonzero((asks != 0) & (welds[later] != welds[one])) + one + 1:
            if _bodies_may(model, int(bodies[one]), int(bodies[other])):
                yield one, int(other)


def _bodies_may(model: mujoco.MjModel, one: int, other: int) -> bool:
    """Not two parts of one rigid body, not a body and its parent, and not bodies that the model excludes."""
    welds = int(model.body_weldid[one]), int(model.body_weldid[other])
    if welds[0] == welds[1]:
        return False
    above = [int(model.body_weldid[model.body_parentid[weld]]) for weld in welds]
    filters = not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_FILTERPARENT
    if filters and 0 not in welds and (above[0] == welds[1] or above[1] == welds[0]):
        return False
    signature = (min(one, other) << 16) + max(one, other)
    return signature not in model.exclude_signature
