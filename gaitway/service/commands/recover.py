"""`gaitway recover`: compares the record and the bucket after a disaster, and makes them agree again.

Composition root.
"""

import logging
from collections import Counter
from collections.abc import Generator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gaitway.cli.errors import complain, wrong_usage
from gaitway.service.commands.services import require

if TYPE_CHECKING:
    from core.settings import StoreSettings

_DONE = {"adopt": "adopted", "mark": "marked"}


def recover(
    adopt: Annotated[
        bool, typer.Option("--adopt", help="Take over what the bucket has and the record does not.")
    ] = False,
    mark: Annotated[
        bool, typer.Option("--mark", help="Remove from the record what the bucket has lost.")
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
    """After a disaster, list where the database and the bucket disagree; without flags, change nothing.

    Exit code 0 if nothing is left to do, 1 if something is.
    """
    require("service", "psycopg", "minio")
    import structlog

    from core.errors import Misconfigured, Unavailable
    from gaitway.service.embedded.processes import ServerFailed

    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.WARNING))
    wanted = {name for name, is_wanted in (("adopt", adopt), ("mark", mark)) if is_wanted}
    try:
        with _settings(data) as settings:
            left = _recover(settings, wanted)
    except Misconfigured as error:
        raise wrong_usage(
            f"{error.detail} For the data of `gaitway up`, name its folder: --data DIR."
        ) from None
    except Unavailable as error:
        complain(f"{error.detail} Then run `gaitway recover` again: what is done already stays done.")
        raise typer.Exit(1) from None
    except ServerFailed as error:
        complain(str(error))
        raise typer.Exit(1) from None
    raise typer.Exit(1 if left else 0)


def _recover(settings: "StoreSettings", wanted: set[str]) -> int:
    """Returns how many findings are left to act on."""
    from core.adapters.postgres import schema
    from core.adapters.wiring import connect_postgres, job_store, object_store
    from core.errors import Conflict, NotFound
    from core.jobs.recovery.findings import findings

    if wanted:  # A database that was lost altogether is new and empty.
        schema.upgrade(connect_postgres(settings.database_url.get_secret_value(), pool_size=0))
    store = job_store(settings)
    left = Counter[str]()
    try:
        for finding in findings(store=store, objects=object_store(settings)):
            done = ""
            if finding.remedy in wanted:
                try:
                    finding.act()
                    done = f" {_DONE[finding.remedy].capitalize()}."
                except (Conflict, NotFound) as error:
                    done = f" Not {_DONE[finding.remedy]}: {error.detail}"
                    left["again"] += 1
            elif finding.remedy is not None:
                left[finding.remedy] += 1
            print(f"{finding.sentence}{done}", flush=True)
    finally:
        store.close()
    print(_summary(left))
    return left.total()


def _summary(left: Counter[str]) -> str:
    said = {
        "adopt": "`gaitway recover --adopt` takes over {} of these.",
        "mark": "`gaitway recover --mark` removes {} of these from the record; adopt first.",
        "again": "{} could not be done; run `gaitway recover` again.",
    }
    return " ".join(said[name].format(left[name]) for name in said if left[name]) or "Nothing is left to do."


@contextmanager
def _settings(data: Path | None) -> "Generator[StoreSettings]":
    """The settings of the two stores. With a data folder, the stores run as long as this is open."""
    from core.configuration import read
    from core.settings import StoreSettings

    if data is None:
        yield read(StoreSettings)
        return
    require("embedded", "psutil")
    from gaitway.service.embedded.folders import private_folder
    from gaitway.service.embedded.postgres import Postgres
    from gaitway.service.embedded.stack import lock_folder
    from gaitway.service.embedded.weed import Weed

    if not (data / "postgres").is_dir():
        raise wrong_usage(f"{data} is not the data folder of a `gaitway up`.")
    data = private_folder(data)
    servers = (Weed(data / "objects"), Postgres(data / "postgres"))
    with lock_folder(data), ExitStack() as stopping:
        for server in servers:
            stopping.callback(server.stop)
            server.launch()
        for server in servers:
            server.wait_ready()
        # Nothing here uses Redis.
        variables = {"GAITWAY_REDIS_URL": "unix:///nowhere"}
        for server in servers:
            variables |= server.environment()
        fields = {name.removeprefix("GAITWAY_").lower(): value for name, value in variables.items()}
        yield StoreSettings.model_validate(fields)
