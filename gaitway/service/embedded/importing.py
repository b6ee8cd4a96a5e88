"""Imports what the embedded stack of version 0.1 left in its folder: `gaitway import-0.1 --data DIR`."""

from pathlib import Path

from core.settings import StoreSettings
from core.variables import PREFIX
from gaitway.service.embedded import version_01
from gaitway.service.embedded.folders import private_folder
from gaitway.service.embedded.servers import EmbeddedServers
from gaitway.service.embedded.stack import lock_folder
from gaitway.service.import_01 import ImportRefused, Report, import_stores


def import_folder(data_dir: Path, report: Report, *, without_redis: bool = False) -> bool:
    """Import jobs and models into the database of the same folder; returns whether all could be read.

    Raises ImportRefused, ServerFailed, Unavailable, Misconfigured.
    """
    if not (data_dir / "objects").is_dir():
        raise ImportRefused(f"{data_dir} is not a data folder of version 0.1.")
    data_dir = private_folder(data_dir)
    if version_01.is_imported(data_dir):
        report(f"{data_dir} is imported already.")
        return True
    with lock_folder(data_dir):
        with EmbeddedServers(data_dir, append_only=True) as servers:
            found = {name.removeprefix(PREFIX).lower(): text for name, text in servers.environment().items()}
            is_whole = import_stores(StoreSettings.model_validate(found), report, without_redis=without_redis)
        if version_01.has_records(data_dir):
            report(f"What version 0.1 had in Valkey is kept in {version_01.set_aside(data_dir)}.")
    return is_whole
