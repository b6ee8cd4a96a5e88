"""Importing dm_control without a display."""

import os
from collections.abc import Generator
from contextlib import contextmanager


@contextmanager
def without_a_display() -> Generator[None]:
    """Modules of dm_control that are imported inside look for no display; the renderer's setting stays."""
    before = os.environ.get("MUJOCO_GL")
    os.environ["MUJOCO_GL"] = "disable"
    try:
        yield
    finally:
        if before is None:
            del os.environ["MUJOCO_GL"]
        else:
            os.environ["MUJOCO_GL"] = before
