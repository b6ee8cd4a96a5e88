"""One clip by the render process: `python -m bench.ours.render_clip FOLDER`. It is small itself, so
that the peak memory of its only child is the render process's."""

import resource
import sys
import time
from pathlib import Path
from typing import Any

from bench.measure.child import answer
from core.rendering.request import RenderRequest
from worker.render.client import render


def work(request: dict[str, Any]) -> dict[str, Any]:
    """wall_s: from the call to the finished file; peak_mb: of the largest process that drew."""
    began = time.perf_counter()
    result = render(RenderRequest.model_validate(request), timeout_s=600)
    wall_s = time.perf_counter() - began
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    return {
        "wall_s": wall_s,
        "peak_mb": peak / 1e6,
        "file_mb": Path(request["video"]).stat().st_size / 1e6,
        "frames": result.frames,
        "gl_backend": result.gl_backend,
        "gl_renderer": result.gl_renderer,
    }


if __name__ == "__main__":
    answer(work)
