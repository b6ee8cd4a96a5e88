"""Where this worker keeps the kernels that Warp compiles."""

import os
from pathlib import Path

from core.physics.availability import check_installed


def set_warp_cache(folder: Path) -> None:
    """Keep the kernels that Warp compiles in this folder, unless WARP_CACHE_PATH names another.

    Call it before the first engine is built: Warp reads the setting once. Raises JobFailed without Warp.
    """
    check_installed("warp")
    import warp

    if "WARP_CACHE_PATH" not in os.environ:
        warp.config.kernel_cache_dir = str(folder)
