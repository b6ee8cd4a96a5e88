"""The loop of `gaitway cluster slurm`: what it does and says while the record or Slurm refuses or is away."""

import json
import stat
from collections.abc import Collection, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from core.errors import Misconfigured, RecordsUnavailable
from core.jobs.slots import CPU, QueueCount, SlotKind
from core.jobs.workers import WorkerInfo
from worker.cluster.launcher import Allocation, LaunchRefused, SchedulerAway
from worker.cluster.main import Loop, Site, own_folder, stores_here
from worker.cluster.options import read_options
from worker.cluster.scale import Limits


class Cluster:
    """A launcher and a record that do what the test says, and a clock that the test moves."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.queued = 1
        self.started = list[tuple[float, SlotKind, int]]()
        self.allocations = list[Allocation]()
        self.asked = 0
        self.trouble: Exception | None = None
        self.record_is_away = False
        self.said = list[str]()

    def start(self, kind: SlotKind, number: int) -> None:
        if self.trouble is not None:
            raise self.trouble
        self.started.append((self.now_s, kind, number))
        self.allocations = [Allocation(str(one), kind, "pending") for one in range(number)]

    def what_runs(self) -> Sequence[Allocation]:
        self.asked += 1
        if isinstance(self.trouble, SchedulerAway):
            raise self.trouble
        return self.allocations

    def stop(self, ids: Collection[str]) -> None:
        self.allocations = [one for one in self.allocations if one.id not in ids]

    def explain(self, allocation: Allocation) -> str:
        return "Its last line: No module named gaitway"

    def queue_counts(self) -> Sequence[QueueCount]:
        if self.record_is_away:
            raise RecordsUnavailable("PostgreSQL is away.")
        return [QueueCount("gaitway-cpu-normal", self.queued, 0, 1.0)] if self.queued else []

    def workers(self) -> Sequence[WorkerInfo]:
        return []

    def now(self) -> datetime:
        return datetime.fromtimestamp(self.now_s, UTC)

    def loop(self) -> Loop:
        record: Any = self
        limits = Limits(4, (CPU,), "cpu")
        return Loop(self, lambda: record, limits, self.said.append, lambda: self.now_s)

    def run(self, loop: Loop, seconds: int) -> None:
        for _ in range(seconds):
            loop.run_once()
            self.now_s += 1


def test_a_queued_job_is_seen_within_seconds_and_at_rest_slurm_is_asked_rarely() -> None:
    cluster = Cluster()
    cluster.queued = 0
    loop = cluster.loop()
    cluster.run(loop, 300)
    assert cluster.asked == 10
    cluster.queued = 2
    cluster.run(loop, 1)
    assert [(kind, number) for _, kind, number in cluster.started] == [(CPU, 2)]


def test_while_slurm_is_away_nothing_is_started_and_it_is_said_once() -> None:
    cluster = Cluster()
    cluster.trouble = SchedulerAway("squeue has not answered within 20 s.")
    loop = cluster.loop()
    cluster.run(loop, 60)
    assert cluster.started == []
    assert cluster.said == [
        "Slurm is away; nothing is started meanwhile. squeue has not answered within 20 s."
    ]
    cluster.trouble = None
    cluster.run(loop, 6)
    assert len(cluster.started) == 1


def test_while_the_record_is_away_allocations_stay_as_they_are() -> None:
    cluster = Cluster()
    cluster.record_is_away = True
    cluster.run(cluster.loop(), 60)
    assert (cluster.asked, cluster.started, len(cluster.said)) == (0, [], 1)


def test_a_refusal_is_said_with_the_time_of_the_next_try() -> None:
    cluster = Cluster()
    cluster.trouble = LaunchRefused("Invalid account specified.")
    loop = cluster.loop()
    cluster.run(loop, 36)
    assert cluster.said == [
        "Slurm refuses a worker (cpu), tried again in 10 s: Invalid account specified.",
        "Slurm refuses a worker (cpu), tried again in 20 s: Invalid account specified.",
        "Slurm refuses a worker (cpu), tried again in 40 s: Invalid account specified.",
    ]


def test_an_allocation_that_ends_too_early_is_explained() -> None:
    cluster = Cluster()
    loop = cluster.loop()
    cluster.run(loop, 1)
    cluster.allocations = [Allocation("0", CPU, "running", "n1")]
    cluster.run(loop, 10)
    cluster.allocations = []
    cluster.run(loop, 10)
    assert cluster.said[1:] == [
        "Slurm job 0 (cpu) ended on n1 before its worker had begun. Its last line: No module named gaitway",
    ]


def test_one_folder_is_for_one_process_and_keeps_its_token(tmp_path: Path) -> None:
    with (
        own_folder(tmp_path) as token,
        pytest.raises(Misconfigured, match="Another `gaitway cluster slurm`"),
        own_folder(tmp_path),
    ):
        pass
    with own_folder(tmp_path) as again:
        assert again == token


def test_without_a_service_it_says_how_to_start_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("GAITWAY_DATABASE_URL", "GAITWAY_SECRETS_DIR"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(Misconfigured, match=r"start `gaitway up --workers 0`"):
        stores_here(tmp_path)


def test_a_service_on_this_machine_is_reached_by_ssh_unless_that_is_declined(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("GAITWAY_DATABASE_URL", "GAITWAY_SECRETS_DIR"):
        monkeypatch.delenv(name, raising=False)
    stores = {
        "GAITWAY_DATABASE_URL": "postgresql://gaitway:hidden@/gaitway?host=%2Fd&port=5432",
        "GAITWAY_REDIS_URL": "unix:///d/valkey.sock",
        "GAITWAY_S3_ENDPOINT": "127.0.0.1:8333",
        "GAITWAY_S3_ACCESS_KEY": "a",
        "GAITWAY_S3_SECRET_KEY": "hidden",
        "GAITWAY_S3_SECURE": "false",
    }
    (tmp_path / "stores.json").write_text(json.dumps(stores))
    site = Site(read_options(None, {"cpu": {}}), tmp_path, tmp_path / "cluster")
    script = site.script(CPU, "g", ())
    assert '-L "$sockets/.s.PGSQL.5432:/d/.s.PGSQL.5432"' in script
    assert "hidden" not in script
    settings = tmp_path / "cluster" / "settings"
    assert "host=@FOLDER@" in (settings / "gaitway_database_url").read_text()
    assert {stat.S_IMODE(file.stat().st_mode) for file in settings.iterdir()} == {0o600}
    plain = Site(read_options(None, {"cpu": {}, "tunnel": "none"}), tmp_path, tmp_path / "cluster")
    assert "ssh" not in plain.script(CPU, "g", ())
    assert "host=%2Fd" in (settings / "gaitway_database_url").read_text()
