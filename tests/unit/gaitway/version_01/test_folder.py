"""`gaitway import-0.1`: the data folder of an embedded stack."""

import os
from pathlib import Path

import pytest

from core.adapters.connect import connect_redis, job_store
from core.adapters.s3.connection import connect_s3
from core.adapters.s3.objects import S3ObjectStore
from core.settings import WorkerSettings
from gaitway.service.embedded.importing import import_folder
from gaitway.service.embedded.processes import ServerFailed
from gaitway.service.embedded.servers import EmbeddedServers
from gaitway.service.embedded.stack import lock_folder
from gaitway.service.embedded.valkey import Valkey
from gaitway.service.embedded.version_01 import report_if_left
from gaitway.service.embedded.weed import Weed
from gaitway.service.embedded.weed_environment import REGION
from tests.unit.gaitway.version_01.old import IDS, command, listed, load_objects, load_redis


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """What the embedded stack of version 0.1 left when it ended."""
    data = tmp_path / "gaitway-data"
    data.mkdir()
    with Valkey(data / "valkey", append_only=True) as valkey, Weed(data / "objects") as weed:
        with connect_redis(valkey.url) as client:
            load_redis(client)
        s3 = connect_s3(weed.endpoint, weed.access_key, weed.secret_key, secure=False, region=REGION)
        load_objects(S3ObjectStore(s3, weed.bucket))
    return data


class TestFolder:
    def test_its_data_are_imported_once(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        reminded: list[str] = []
        report_if_left(folder, reminded.append)
        assert f"gaitway import-0.1 --data {folder}" in reminded[0]
        said: list[str] = []
        assert import_folder(folder, said.append)
        assert "Jobs: 8 imported, 0 in the record before, 0 not readable." in said
        assert not (folder / "valkey" / "appendonlydir").exists()
        assert (folder / "valkey" / "appendonlydir.imported" / "appendonly.aof.manifest").exists()
        report_if_left(folder, reminded.append)
        assert len(reminded) == 1
        with EmbeddedServers(folder) as servers:
            for name, value in servers.environment().items():
                monkeypatch.setenv(name, value)
            store = job_store(WorkerSettings(data_dir=folder))  # type: ignore[call-arg]
            assert set(listed(store)) == set(IDS)
            store.close()
        assert import_folder(folder, said.append)
        assert said[-1] == f"{folder} is imported already."

    def test_nobody_imports_beside_a_running_stack(self, folder: Path) -> None:
        with lock_folder(folder), pytest.raises(ServerFailed, match=f"Process {os.getpid()} already runs"):
            import_folder(folder, print)
        assert (folder / "valkey" / "appendonlydir").is_dir()

    def test_a_folder_of_something_else_is_refused_and_left_as_it_is(self, tmp_path: Path) -> None:
        found = command("--data", str(tmp_path / "nothing"))
        assert found.returncode == 1
        assert "is not a data folder of version 0.1" in found.stderr
        assert not (tmp_path / "nothing").exists()

    def test_records_of_a_second_time_are_kept_beside_the_first(self, tmp_path: Path) -> None:
        from gaitway.service.embedded.version_01 import set_aside

        for expected in ("appendonlydir.imported", "appendonlydir.imported-2", "appendonlydir.imported-3"):
            (tmp_path / "valkey" / "appendonlydir").mkdir(parents=True)
            assert set_aside(tmp_path).name == expected
