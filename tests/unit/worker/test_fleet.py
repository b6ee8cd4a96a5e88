"""A fleet is a worker for each device: real processes, real stores."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

from core.adapters.postgres.store import PostgresJobStore
from core.errors import EXIT_STATUS, Misconfigured
from core.jobs.workers import WorkerInfo
from core.settings import WorkerSettings
from tests.unit.worker.environments import environment
from worker.fleet import Member, main


class Fleet:
    """A fleet of two CPU workers, and what the service knows of it."""

    def __init__(self, settings: WorkerSettings, store: PostgresJobStore, log: Path) -> None:
        self._store = store
        with log.open("wb") as file:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "worker.fleet", "cpu", "cpu"],
                env=environment(settings, GAITWAY_ALIVE_FILE=str(log.with_name("alive"))),
                stdout=file,
                stderr=subprocess.STDOUT,
            )

    def two_workers(self, without: int = 0) -> list[WorkerInfo]:
        """The two that are announced, once there are two besides the one with this process id."""
        found = list[WorkerInfo]()

        def are_two() -> bool:
            assert self.process.poll() is None
            found[:] = [worker for worker in self._store.workers() if worker.pid != without]
            return len(found) == 2

        wait_until(are_two)
        return found


def wait_until(condition: Callable[[], bool], timeout_s: float = 30) -> None:
    deadline = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.02)


def is_gone(pid: int) -> bool:
    try:
        return psutil.Process(pid).status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return tmp_path / "fleet.log"


@pytest.fixture
def fleet(settings: WorkerSettings, job_store: PostgresJobStore, log: Path) -> Iterator[Fleet]:
    fleet = Fleet(settings, job_store, log)
    yield fleet
    children = psutil.Process(fleet.process.pid).children() if fleet.process.poll() is None else []
    for process in (fleet.process, *children):
        process.kill()
    fleet.process.wait(10)


@pytest.mark.extra
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_to_the_fleet_ends_all_its_workers_and_it_waits_for_them(
    fleet: Fleet, number: signal.Signals
) -> None:
    workers = fleet.two_workers()
    assert [worker.device for worker in workers] == ["cpu", "cpu"]
    fleet.process.send_signal(number)
    assert fleet.process.wait(20) == 0
    assert not any(psutil.pid_exists(worker.pid) for worker in workers)


def test_a_worker_that_ends_by_itself_is_started_again(fleet: Fleet, log: Path) -> None:
    victim, other = fleet.two_workers()
    os.kill(victim.pid, signal.SIGKILL)
    assert other.pid in {worker.pid for worker in fleet.two_workers(without=victim.pid)}
    ended = [json.loads(line) for line in log.read_text().splitlines() if "worker_ended" in line]
    assert [(line["device"], line["status"], line["again_in_s"]) for line in ended] == [
        ("cpu", -signal.SIGKILL, 0.25)
    ]


def test_every_worker_shows_life_in_a_file_of_its_own_and_none_outlives_a_fleet_that_is_killed(
    fleet: Fleet, log: Path
) -> None:
    workers = fleet.two_workers()
    began = min(worker.started_at.timestamp() for worker in workers)
    # The fleet made the files before it started the workers.
    assert all(log.with_name(f"alive.{number}").stat().st_mtime > began for number in (0, 1))
    assert not log.with_name("alive").exists()
    fleet.process.kill()
    wait_until(lambda: all(is_gone(worker.pid) for worker in workers))


def run_fleet(*devices: str, **variables: str) -> subprocess.CompletedProcess[str]:
    outer = {name: value for name, value in os.environ.items() if not name.startswith("GAITWAY_")}
    return subprocess.run(
        [sys.executable, "-m", "worker.fleet", *devices],
        env={**outer, **variables},
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )


def misconfigurations(said: str) -> list[str]:
    lines = map(json.loads, said.splitlines())
    return [line["detail"] for line in lines if line["event"] == "misconfigured"]


@pytest.mark.extra
def test_a_worker_that_is_misconfigured_ends_the_fleet_with_its_status_and_is_not_tried_again() -> None:
    done = run_fleet("cpu", "cpu")  # Without a single setting.
    said = misconfigurations(done.stdout)
    assert done.returncode == EXIT_STATUS
    assert 2 <= len(said) <= 3  # Of the fleet, and of the workers that came so far.
    assert "GAITWAY_DATABASE_URL is not set" in said[0]
    assert "The worker on cpu cannot work as it is set up" in said[-1]


@pytest.fixture
def nothing_set(monkeypatch: pytest.MonkeyPatch) -> None:
    """No setting in the environment: every worker ends with the status of a misconfigured one."""
    for name in os.environ:
        if name.startswith("GAITWAY_"):
            monkeypatch.delenv(name)


def ended(member: Member) -> Member:
    member.look_after()
    assert member.child is not None
    assert member.child.wait(30) == EXIT_STATUS
    return member


@pytest.mark.extra
@pytest.mark.usefixtures("nothing_set")
def test_a_worker_that_could_never_work_ends_the_fleet() -> None:
    with pytest.raises(Misconfigured, match="The worker on cpu cannot work"):
        ended(Member("cpu")).look_after()


@pytest.mark.extra
@pytest.mark.usefixtures("nothing_set")
def test_a_worker_that_worked_before_is_tried_again_and_leaves_the_others_alone() -> None:
    member = ended(Member("cpu"))
    member.started_at -= 31  # It ran for so long.
    member.look_after()
    assert (member.child, member.pause_s) == (None, 0.5)
    member.start_at = 0  # The pause is over; now it ends at once.
    ended(member).look_after()
    assert (member.child, member.pause_s) == (None, 1.0)


@pytest.mark.skipif(any(Path("/dev").glob("nvidia[0-9]*")), reason="there is a GPU")
def test_a_fleet_without_a_gpu_says_what_to_do() -> None:
    done = run_fleet()
    (said,) = misconfigurations(done.stdout)
    assert done.returncode == EXIT_STATUS
    for remedy in ("No NVIDIA GPU is visible here", "--profile gpu", "NVIDIA Container Toolkit"):
        assert remedy in said


def test_a_fleet_that_has_a_gpu_twice_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["gpu:0-1", "gpu:1,2"])
    assert ended.value.code == EXIT_STATUS
    (said,) = misconfigurations(capsys.readouterr().out)
    assert said.startswith("The fleet gpu:0-1 gpu:1,2 has GPU 1 twice")


def test_all_gpus_of_a_machine_are_one_pool(monkeypatch: pytest.MonkeyPatch) -> None:
    served = list[Member]()
    monkeypatch.delenv("GAITWAY_POOL", raising=False)
    monkeypatch.setenv("GAITWAY_SEATS", "1")
    monkeypatch.setattr("worker.fleet.visible_gpus", lambda: ["nvidia0", "nvidia1", "nvidia2"])
    monkeypatch.setattr("worker.fleet.serve", served.extend)
    main([])
    main(["gpu:0,1", "gpu:2"])
    monkeypatch.setenv("GAITWAY_POOL", "gpu:1-2")
    main([])
    monkeypatch.setattr("worker.fleet.visible_gpus", lambda: ["nvidia0"])
    monkeypatch.delenv("GAITWAY_POOL")
    main([])
    assert [(member.device, member.pool) for member in served] == [
        *((f"gpu:{number}", "gpu:0,1,2") for number in range(3)),
        ("gpu:0,1", None),
        ("gpu:2", None),
        *((f"gpu:{number}", "gpu:1,2") for number in (1, 2)),
        ("gpu:0", None),
    ]


def test_a_gpu_of_a_pool_has_a_worker_for_each_job_that_may_share_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    served = list[Member]()
    monkeypatch.delenv("GAITWAY_SEATS", raising=False)
    monkeypatch.setattr("worker.fleet.serve", served.extend)
    monkeypatch.setenv("GAITWAY_POOL", "gpu:0")
    main([])
    main(["gpu:0"])  # Fixed devices are one job's.
    assert [(member.device, member.pool, member.seat) for member in served] == [
        ("gpu:0", "gpu:0", 0),
        ("gpu:0", "gpu:0", 1),
        ("gpu:0", None, None),
    ]
    monkeypatch.setenv("GAITWAY_SEATS", "none")
    with pytest.raises(SystemExit):
        main([])


def test_the_fleet_loads_no_numerical_stack() -> None:
    code = "import sys, worker.fleet; print({'jax', 'mujoco', 'numpy'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"
