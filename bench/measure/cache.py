"""What a child process keeps on disk for the next one, as a worker does."""

from pathlib import Path
from typing import Any


def keep_compiled(request: dict[str, Any]) -> None:
    """Keep what JAX and the request's engine compile in its folder `cache`, if it has one."""
    import jax

    from core.physics.compiled.code.kept_code import keep_code
    from core.physics.kernels import keep_kernels

    if not request.get("cache"):
        return
    jax.config.update("jax_compilation_cache_dir", request["cache"])
    match request["engine"]:
        case "warp":
            keep_kernels(Path(request["cache"], "warp"))
        case "compiled":
            keep_code(Path(request["cache"], "compiled"))
        case _:
            pass
