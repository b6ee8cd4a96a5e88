"""Height fields: a grid of heights, of which each cell is two prisms that stand on the field's base.

Source: MuJoCo's documentation, XML reference, "asset/hfield"; `mjc_ConvexHField`.
"""

from dataclasses import dataclass, field
from math import ceil

import mujoco
import numpy as np

# Under a geom: each is looked at in every substep.
MOST_CELLS = 256
# Of a field: they lie in the code's tables.
MOST_HEIGHTS = 2**18


@dataclass(frozen=True)
class HeightField:
    """In its geom's frame, in m. number: MuJoCo's. half: half its lengths along x and y. heights: row by row,
    along x first. top: of the highest that it may be. base: how far down it goes."""

    number: int
    num_rows: int
    num_columns: int
    half: tuple[float, float]
    top: float
    base: float
    heights: tuple[float, ...] = field(repr=False)

    @property
    def cell(self) -> tuple[float, float]:
        """A cell's lengths along x and y."""
        x, y = self.half
        return 2.0 * x / (self.num_columns - 1), 2.0 * y / (self.num_rows - 1)

    def window(self, bound: float) -> tuple[int, int]:
        """Along x and y: over how many cells a geom is at most. bound: of the sphere about it, in m."""
        along, across = (ceil(2.0 * bound / length) + 1 for length in self.cell)
        return min(along, self.num_columns - 1), min(across, self.num_rows - 1)


def read_field(model: mujoco.MjModel, geom: int) -> HeightField | None:
    """The field of a geom that is one."""
    if model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_HFIELD:
        return None
    number = int(model.geom_dataid[geom])
    num_rows, num_columns = int(model.hfield_nrow[number]), int(model.hfield_ncol[number])
    x, y, top, base = (float(size) for size in model.hfield_size[number])
    first = int(model.hfield_adr[number])
    heights = top * np.asarray(model.hfield_data[first : first + num_rows * num_columns], float)
    return HeightField(number, num_rows, num_columns, (x, y), top, base, tuple(heights.tolist()))
