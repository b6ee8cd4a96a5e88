"""The seam to a renderer of a model."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class Renderer(Protocol):
    """Draws one model from one camera."""

    @property
    def gl_renderer(self) -> str:
        """The name that the GL driver reports; `llvmpipe` means software."""
        ...

    def frame(self, qpos: NDArray[np.float64]) -> NDArray[np.uint8]:
        """RGB [height, width, 3] of the positions qpos [nq]."""
        ...

    def close(self) -> None: ...
