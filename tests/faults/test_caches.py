"""What was compiled once: found by the next job, here and on another machine, whatever fails on the way."""

import json
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from core.adapters.postgres.store import PostgresJobStore
from core.adapters.s3.objects import S3ObjectStore
from core.errors import StorageUnavailable
from core.jobs.job import utc_now
from core.jobs.status import JobStatus
from core.jobs.store import JobStore
from core.reasons import Reason
from core.storage import keys
from tests.faults.bench import Bench
from worker.compile_cache import session
from worker.compile_cache.fingerprint import fingerprint
from worker.compile_cache.local import names
from worker.compile_cache.remote import SharedCache

_JAX = str(Path(__file__).with_name("jax_process.py"))


class Machine(Bench):
    """A service whose objects may be another's, and a worker with a data folder of its own."""

    def __init__(self, data_dir: Path, store: JobStore, objects: Any = None, **settings: Any) -> None:
        super().__init__(data_dir, store)
        self.objects = objects or self.objects
        self.settings = self.settings.model_copy(update=settings)

    @property
    def kept(self) -> Path:
        """The only folder of a machine with one device."""
        (folder,) = (self.settings.data_dir / "cache").iterdir()
        return folder

    def compiles(self) -> dict[str, Any]:
        """How JAX came by the program of one job."""
        job = self.submit()
        supervisor = self.supervisor(job, "")
        supervisor.command = (sys.executable, _JAX)
        supervisor.run()
        done = self.store.get(job.id)
        assert done.status == JobStatus.SUCCEEDED, done.message
        summary = done.newest("summary")
        assert summary is not None
        return json.loads(self.objects.get(summary.key))


def test_a_second_machine_starts_warm(
    tmp_path: Path, job_store: PostgresJobStore, object_store: S3ObjectStore
) -> None:
    first = Machine(tmp_path / "first", job_store, object_store).compiles()
    assert (first["hits"], first["misses"]) == (0, 1)
    # Another folder of another depth, which JAX 0.10 would take for another program.
    second = Machine(tmp_path / "elsewhere" / "second", job_store, object_store).compiles()
    assert (second["hits"], second["misses"]) == (1, 0)
    assert second["result"] == first["result"]


@pytest.mark.extra
def test_a_machine_may_keep_nothing_and_still_share(tmp_path: Path, job_store: PostgresJobStore) -> None:
    machine = Machine(tmp_path, job_store, cache_max_bytes=0)
    assert machine.run("compiles").status == JobStatus.SUCCEEDED
    assert names(tmp_path / "cache") == set()
    assert [info.key.rpartition("/")[2] for info in machine.objects.list(keys.caches())] == ["compiled"]


@pytest.mark.extra
def test_a_machine_may_keep_all_and_share_nothing(tmp_path: Path, job_store: PostgresJobStore) -> None:
    machine = Machine(tmp_path, job_store, shared_cache_max_bytes=0)
    assert machine.run("compiles").status == JobStatus.SUCCEEDED
    assert names(machine.kept) == {"jax/compiled"}
    assert list(machine.objects.list(keys.caches())) == []


@pytest.mark.extra
def test_a_damaged_program_is_compiled_again(tmp_path: Path, job_store: PostgresJobStore) -> None:
    machine = Machine(tmp_path, job_store, shared_cache_max_bytes=0)
    right = machine.compiles()["result"]
    for name in names(machine.kept):
        (machine.kept / name).write_bytes(b"half a program")
    again = machine.compiles()
    assert (again["hits"], again["result"]) == (0, right)
    assert "Error reading persistent compilation cache entry" in again["warnings"][0]


@pytest.mark.extra
@pytest.mark.parametrize("method", ["list", "open", "put_file"])
def test_a_store_that_fails_leaves_the_job_alone(
    method: str, tmp_path: Path, job_store: PostgresJobStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Bench(tmp_path, job_store)
    shared = SharedCache(bench.objects, fingerprint("cpu"), "ant")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "known").write_bytes(b"a program")
    shared.store(tmp_path / "other", ["known"], utc_now())
    passed_on = getattr(bench.objects, method)

    def away(key: str, *rest: Any, **named: Any) -> Any:
        if key.startswith(keys.caches()):
            raise StorageUnavailable("The test switched it off.")
        return passed_on(key, *rest, **named)

    monkeypatch.setattr(bench.objects, method, away)
    assert bench.run("compiles").status == JobStatus.SUCCEEDED
    kept = names(tmp_path / "cache" / fingerprint("cpu"))
    assert "jax/compiled" in kept
    assert ("known" in kept) == (method == "put_file")


@pytest.mark.extra
def test_a_silent_store_delays_a_job_by_its_patience_alone(
    tmp_path: Path, job_store: PostgresJobStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Bench(tmp_path, job_store)
    silent = threading.Event()
    monkeypatch.setattr(bench.objects, "list", lambda _: silent.wait(30) and iter(()))
    monkeypatch.setattr(session, "_FETCH_TIMEOUT_S", 0.1)
    monkeypatch.setattr(session, "_STORE_TIMEOUT_S", 0.1)
    began = time.monotonic()
    assert bench.run("compiles").status == JobStatus.SUCCEEDED
    assert time.monotonic() - began < 20
    silent.set()


@pytest.mark.extra
def test_a_drain_does_not_wait_for_the_store(
    tmp_path: Path, job_store: PostgresJobStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Bench(tmp_path, job_store)
    silent = threading.Event()
    monkeypatch.setattr(bench.objects, "list", lambda _: silent.wait(30) and iter(()))
    job = bench.submit()
    supervisor = bench.supervisor(job, "compiles")
    threading.Timer(0.2, supervisor.draining.set).start()
    began = time.monotonic()
    supervisor.run()
    assert time.monotonic() - began < 5  # of the 10 s that it would have waited
    assert bench.store.get(job.id).attempts[0].reason == Reason.WORKER_DRAINED
    silent.set()


@pytest.mark.extra
def test_what_a_crash_left_is_not_kept(tmp_path: Path, job_store: PostgresJobStore) -> None:
    bench = Bench(tmp_path, job_store)
    bench.run("compiles_and_crashes")
    assert names(tmp_path / "cache") == set()
