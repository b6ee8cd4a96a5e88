"""`gaitway import-0.1`: what it says, and its exit status."""

import json

import pytest

from core.settings import WorkerSettings
from gaitway.service.import_01 import ImportRefused, import_stores, refuse_while_at_work
from tests.unit.gaitway.version_01.old import IDS, Old, command, environment_of


class TestWhatIsSaid:
    def test_a_worker_of_version_01_that_is_alive_keeps_the_import_from_beginning(self, old: Old) -> None:
        refuse_while_at_work(old.settings)
        old.redis.sadd("gaitway:workers", "host-1", "host-2")
        old.redis.set("gaitway:worker:host-2", "{}", px=60_000)
        with pytest.raises(ImportRefused, match=r"still running: host-2\."):
            refuse_while_at_work(old.settings)

    def test_every_hundred_jobs_there_is_a_line(self, old: Old) -> None:
        document = old.live("queued")
        for number in range(195):
            job_id = f"01a200000000-{number:010x}"
            old.objects.put(f"jobs/{job_id}/spec.json", json.dumps({**document, "id": job_id}).encode())
        is_whole, said = old.import_all()
        assert is_whole
        assert said == [
            "100 of 203 jobs",
            "200 of 203 jobs",
            "Models: 3 imported, 0 in the record before, 0 not readable.",
            "Jobs: 203 imported, 0 in the record before, 0 not readable.",
        ]

    def test_nothing_to_import_is_no_failure(self, settings: WorkerSettings) -> None:
        said: list[str] = []
        assert import_stores(settings, said.append)
        assert said[-1] == "Jobs: 0 imported, 0 in the record before, 0 not readable."


class TestCommand:
    def test_its_exit_status_says_whether_all_could_be_read(self, old: Old) -> None:
        found = command(**environment_of(old.settings))
        assert (found.returncode, found.stderr) == (0, "")
        assert found.stdout.splitlines() == [
            "Models: 3 imported, 0 in the record before, 0 not readable.",
            "Jobs: 8 imported, 0 in the record before, 0 not readable.",
        ]

    def test_a_damaged_record_is_a_failure(self, old: Old) -> None:
        old.write_live("cancelling", "{")
        found = command(**environment_of(old.settings))
        assert (found.returncode, IDS["cancelling"] in found.stdout) == (1, True)

    def test_a_store_that_is_away_is_told_in_a_sentence(self, old: Old) -> None:
        away = {"GAITWAY_REDIS_URL": "unix:///nobody/is.here"}
        found = command(**{**environment_of(old.settings), **away})
        assert found.returncode == 1
        assert found.stderr.startswith("gaitway: Redis does not answer at GAITWAY_REDIS_URL")
        assert found.stderr.count("\n") == 1

    def test_missing_settings_are_named(self) -> None:
        found = command()
        assert found.returncode == 2
        assert "GAITWAY_DATABASE_URL is not set" in found.stderr
        assert "--data DIR" in found.stderr
