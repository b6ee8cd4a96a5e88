"""`gaitway import-0.1`: a second time, also after one that was killed."""

import base64
import os
import signal
import subprocess
import sys

import pytest

from core.adapters.postgres.jobs import PostgresJobStore
from core.jobs.deletion import delete
from core.jobs.status import JobStatus
from tests.unit.gaitway.version_01.old import (
    IDS,
    LEASE,
    OLD,
    Old,
    environment_of,
    feed,
    listed,
    streamed,
    told,
)


class TestAgain:
    def test_a_second_import_changes_nothing(self, old: Old, job_store: PostgresJobStore) -> None:
        old.import_all()
        before, events = listed(job_store), {name: feed(old, job_store, name) for name in IDS}
        is_whole, said = old.import_all()
        assert is_whole
        assert said[-2:] == [
            "Models: 0 imported, 3 in the record before, 0 not readable.",
            "Jobs: 0 imported, 8 in the record before, 0 not readable.",
        ]
        assert listed(job_store) == before
        assert {name: feed(old, job_store, name) for name in IDS} == events

    def test_what_went_on_since_stays_and_what_was_deleted_since_stays_away(
        self, old: Old, job_store: PostgresJobStore
    ) -> None:
        old.import_all()
        job = job_store.get(IDS["running"])
        job_store.save(job.claimed("w", job_store.now()), lease=LEASE)
        delete(IDS["failed"], store=job_store, objects=old.objects)
        old.import_all()
        assert job_store.get(job.id).status == JobStatus.STARTING
        assert set(listed(job_store)) == set(IDS) - {"failed"}

    def test_an_imported_job_without_its_old_papers_is_not_taken_for_deleted(self, old: Old) -> None:
        # The sweep of orphans may remove what no record names.
        old.import_all()
        old.objects.delete([f"jobs/{job_id}/spec.json" for job_id in IDS.values()])
        assert old.import_all() == (
            True,
            [
                "Models: 0 imported, 3 in the record before, 0 not readable.",
                "Jobs: 0 imported, 0 in the record before, 0 not readable.",
            ],
        )

    @pytest.mark.parametrize("after", [0, 3])
    def test_an_import_that_was_killed_is_finished_by_the_next(
        self, after: int, old: Old, job_store: PostgresJobStore
    ) -> None:
        killed = subprocess.run(
            [sys.executable, "-c", KILLED, str(after)],
            env={**os.environ, **environment_of(old.settings)},
            capture_output=True,
            text=True,
        )
        assert killed.returncode == -signal.SIGKILL, killed.stderr
        # Nothing of the job whose feed was just being stored: all of it is one transaction.
        assert sorted(job.id for job in listed(job_store).values()) == sorted(IDS.values())[:after]
        is_whole, said = old.import_all()
        assert is_whole
        assert said[-1] == f"Jobs: {8 - after} imported, {after} in the record before, 0 not readable."
        assert told(feed(old, job_store, "succeeded")) == streamed("succeeded")
        assert len(feed(old, job_store, "running")) == len(streamed("running")) + 1

    def test_nothing_of_version_01_is_changed(self, old: Old) -> None:
        before = {key: old.redis.dump(key) for key in old.redis.scan_iter()}
        old.import_all()
        assert {key: old.redis.dump(key) for key in old.redis.scan_iter()} == before
        for key, body in OLD["objects"].items():
            assert old.objects.get(key) == base64.b64decode(body)


# Imports like anybody, and dies while it stores the feed of the job after the first `argv[1]`.
KILLED = """
import os, signal, sys
from core.adapters.postgres.jobs import PostgresJobStore
from core.configuration import read
from core.settings import StoreSettings
from gaitway.service.import_01 import import_stores

original, count = PostgresJobStore.import_job, 0

def dying(logs):
    yield from logs
    os.kill(os.getpid(), signal.SIGKILL)

def import_job(store, job, events, logs, keys):
    global count
    count += 1
    return original(store, job, events, dying(logs) if count > int(sys.argv[1]) else logs, keys)

PostgresJobStore.import_job = import_job
import_stores(read(StoreSettings), print)
"""
