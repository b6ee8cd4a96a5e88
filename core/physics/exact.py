"""Numbers of MuJoCo's own precision among arrays of float32."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]


def in_parts(values: NDArray[np.float64] | float) -> Floats:
    """Numbers [...] as sums of three float32, [..., 3], which hold all of their bits."""
    rest, parts = np.asarray(values, np.float64), list[Floats]()
    for _ in range(3):
        parts.append(rest.astype(np.float32))
        rest = rest - parts[-1]
    return np.stack(parts, axis=-1)


def of_parts(parts: Floats) -> NDArray[np.float64]:
    """The numbers of `in_parts`."""
    return parts.astype(np.float64).sum(axis=-1)
