"""The terminal program `gaitway`, which needs the extra `cli`; the service's commands need `up`."""

import sys


def main() -> None:
    """Run it. Exits with a sentence where its packages are not installed."""
    try:
        from gaitway.cli.main import app
    except ModuleNotFoundError as missing:
        if missing.name not in ("rich", "typer"):
            raise
        sys.exit(
            "gaitway: Only the Python client is installed: `pip install 'gaitway[up]'` has the service and "
            "all commands, `pip install 'gaitway[cli]'` those for a service elsewhere."
        )
    app()
