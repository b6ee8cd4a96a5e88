"""Whether this worker can build the engine `warp`, and where it keeps the kernels that Warp compiles."""

import os
from pathlib import Path

from core.errors import JobFailed
from core.physics.availability import has_warp
from core.reasons import Reason


def check_warp() -> None:
    """Raises JobFailed("no_device") if this worker cannot build the engine `warp`."""
    if not has_warp():
        raise JobFailed(
            Reason.NO_DEVICE,
            "The job asks for the engine 'warp', which this worker does not have. Install it in its clone "
            "with `uv sync --inexact --extra warp`, or ask for 'auto', 'native' or 'mjx'.",
        )


def keep_kernels(folder: Path) -> None:
    """Keep the kernels that Warp compiles in this folder, unless WARP_CACHE_PATH names another.

    Call it before the first engine is built: Warp reads the setting once. Raises JobFailed without Warp.
    """
    check_warp()
    import warp

    if "WARP_CACHE_PATH" not in os.environ:
        warp.config.kernel_cache_dir = str(folder)
