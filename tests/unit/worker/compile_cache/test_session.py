"""Which compiled programs a job gets, and who gets what it compiled (H6b)."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

from core.jobs.spec import EnvironmentSpec
from tests.in_memory import MemoryObjectStore
from worker.compile_cache.local import CACHE
from worker.compile_cache.session import Caches


class Machine:
    def __init__(self, data_dir: Path) -> None:
        self.data_dir, self.number = data_dir, 0
        self.settings: Any = SimpleNamespace(
            data_dir=data_dir, cache_max_bytes=2**30, shared_cache_max_bytes=0
        )

    def begins(self, environment: EnvironmentSpec) -> tuple[Caches, Path]:
        self.number += 1
        spool, room = self.data_dir / f"job.{self.number}", self.data_dir / f"room.{self.number}"
        room.mkdir(parents=True)
        caches = Caches(MemoryObjectStore(), self.settings, "cpu", spool, room)
        caches.open(environment, lambda: False)
        return caches, spool / CACHE

    def runs(self, environment: EnvironmentSpec, compiles: str) -> dict[str, bytes]:
        """The programs that a job began with; it overwrites each, and leaves another."""
        caches, own = self.begins(environment)
        found = {path.name: path.read_bytes() for path in own.rglob("*") if path.is_file()}
        if environment.id == "mjcf":
            for name in found:
                (own / "compiled" / name).write_bytes(b"overwritten")
        (own / "compiled").mkdir(exist_ok=True, parents=True)
        (own / "compiled" / compiles).write_bytes(b"by " + compiles.encode())
        caches.keep()
        return found


def with_model(digit: str) -> EnvironmentSpec:
    return EnvironmentSpec(id="mjcf", options={"model": f"sha256:{digit * 64}"})


def test_h6b_what_a_job_with_a_users_model_leaves_goes_to_jobs_with_that_model_alone(tmp_path: Path) -> None:
    machine, ant = Machine(tmp_path), EnvironmentSpec(id="ant", options={})
    assert machine.runs(ant, "first") == {}
    assert machine.runs(with_model("a"), "of-a") == {"first": b"by first"}
    assert machine.runs(with_model("b"), "of-b") == {"first": b"by first"}
    assert machine.runs(ant, "second") == {"first": b"by first"}
    assert machine.runs(with_model("a"), "again-a") == {
        "first": b"by first",
        "second": b"by second",
        "of-a": b"by of-a",
    }
    assert machine.runs(ant, "third") == {"first": b"by first", "second": b"by second"}
