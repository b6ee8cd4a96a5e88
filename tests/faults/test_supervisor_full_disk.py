"""A disk without room: a real one in memory, where this user may mount it."""

import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from core.adapters.postgres.store import PostgresJobStore
from core.adapters.rq.queue import RQQueue
from core.errors import Misconfigured, RecordsUnavailable
from core.jobs.spec import JOB_SPEC
from core.jobs.status import JobStatus
from core.jobs.submission import submit
from core.reasons import Reason
from core.rendering.gl import RenderingFailed
from core.settings import WorkerSettings
from tests.faults.bench import SPEC, Bench
from tests.unit.rendering.conftest import ball_request, rolling_ball, why_no_gl
from tests.unit.worker.environments import environment
from worker.host.child import TRAINING
from worker.host.disk import check_folder, has_room
from worker.supervision import supervisor as supervisor_module

MakeDisk = Callable[[int], Path]


@pytest.fixture
def make_disk(tmp_path: Path) -> Iterator[MakeDisk]:
    """Mounts an empty disk of so many KiB."""
    folder = tmp_path / "disk"

    def mount(size_kib: int) -> Path:
        folder.mkdir()
        command = ["mount", "-t", "tmpfs", "-o", f"size={size_kib}k", "tmpfs", str(folder)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            pytest.skip(f"no disk can be mounted here: {done.stderr.strip()}")
        return folder

    yield mount
    if folder.is_mount():
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


def fill(folder: Path, *, leave_kib: int = 0) -> Path:
    """Write a file that leaves so much room."""
    filling = folder / "filling"
    filling.write_bytes(bytes(shutil.disk_usage(folder).free - 1024 * leave_kib))
    return filling


def says_what_to_do(message: str | None, folder: Path) -> bool:
    return message is not None and f"GAITWAY_DATA_DIR={folder}" in message and "free space" in message


@pytest.mark.extra
@pytest.mark.usefixtures("compiled_quickly")
def test_a_checkpoint_that_does_not_fit_ends_the_job_with_the_setting_and_the_remedy(
    make_disk: MakeDisk, job_store: PostgresJobStore, capfd: pytest.CaptureFixture[str]
) -> None:
    disk = make_disk(1024)
    bench = Bench(disk, job_store)
    job = bench.submit(**{**SPEC, "checkpoints": {"every_steps": 640}, "max_attempts": 1})
    supervisor = bench.supervisor(job, "")
    supervisor.command = TRAINING
    # Room for the task; the state of 64 worlds is more than this.
    fill(disk, leave_kib=16)
    supervisor.run()
    ended = bench.store.get(job.id)
    assert (ended.status, ended.reason) == (JobStatus.FAILED, Reason.STORAGE_UNAVAILABLE)
    assert says_what_to_do(ended.message, disk)
    assert says_what_to_do(capfd.readouterr().out, disk)


@pytest.mark.extra
def test_a_task_that_does_not_fit_is_given_back_until_its_attempts_are_used_up(
    make_disk: MakeDisk, job_store: PostgresJobStore
) -> None:
    disk = make_disk(1024)
    bench = Bench(disk, job_store)
    fill(disk)
    job = bench.submit(max_attempts=2)
    bench.supervisor(job, "succeeds").run()
    given_back = bench.store.get(job.id)
    assert (given_back.status, given_back.attempts[0].reason) == (
        JobStatus.QUEUED,
        Reason.STORAGE_UNAVAILABLE,
    )
    assert says_what_to_do(given_back.attempts[0].message, disk)
    bench.supervisor(job, "succeeds").run()
    ended = bench.store.get(job.id)
    assert (ended.status, ended.reason) == (JobStatus.FAILED, Reason.STORAGE_UNAVAILABLE)


def test_a_job_goes_on_once_there_is_room_again(make_disk: MakeDisk, job_store: PostgresJobStore) -> None:
    disk = make_disk(1024)
    bench = Bench(disk, job_store)
    filling = fill(disk)
    job = bench.submit()
    bench.supervisor(job, "succeeds").run()
    filling.unlink()
    bench.supervisor(job, "succeeds").run()
    assert bench.store.get(job.id).status == JobStatus.SUCCEEDED


@pytest.mark.extra
def test_a_video_that_does_not_fit_is_no_reason_to_fail_and_says_why(
    make_disk: MakeDisk, monkeypatch: pytest.MonkeyPatch
) -> None:
    from worker.render.client import render

    if reason := why_no_gl():
        pytest.skip(reason)
    disk = make_disk(1024)
    monkeypatch.setenv("GAITWAY_DATA_DIR", str(disk))
    request = ball_request(disk, rolling_ball(4.0), seconds=4.0, width=640, height=480, fps=30)
    fill(disk, leave_kib=16)
    with pytest.raises(RenderingFailed) as failure:
        render(request, timeout_s=60.0)
    assert says_what_to_do(failure.value.detail, disk)
    assert not request.video.exists()


def test_a_worker_without_room_leaves_jobs_in_the_queue(
    make_disk: MakeDisk, settings: WorkerSettings, job_store: PostgresJobStore, redis_client: Any
) -> None:
    disk = make_disk(1024)
    job = submit(JOB_SPEC.validate_python(SPEC), store=job_store, queue=RQQueue(redis_client))
    code = "import sys; from worker.tasks import run_attempt; run_attempt(sys.argv[1], 1)"
    done = subprocess.run(
        [sys.executable, "-c", code, job.id],
        env=environment(settings, GAITWAY_DATA_DIR=str(disk)),
        capture_output=True,
        text=True,
        check=True,
    )
    assert "no_job_begun" in done.stdout
    assert says_what_to_do(done.stdout, disk)
    assert job_store.get(job.id) == job


def test_room_is_what_a_small_job_needs(make_disk: MakeDisk) -> None:
    disk = make_disk(32 * 1024)
    assert has_room(disk)
    fill(disk, leave_kib=1024)
    assert not has_room(disk)
    check_folder(disk)  # Time may mend it.


def test_a_folder_that_cannot_be_written_to_is_a_wrong_setting(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(Misconfigured, match=r"^GAITWAY_DATA_DIR=[^,]*, and user .* cannot write there"):
        check_folder(tmp_path / "file" / "data")


@pytest.mark.extra
def test_results_that_no_store_takes_end_the_attempt_for_that_reason(
    tmp_path: Path, job_store: PostgresJobStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Bench(tmp_path, job_store)

    def away(*_: Any, **__: Any) -> None:
        raise RecordsUnavailable("The test switched it off.")

    monkeypatch.setattr(bench.store, "record", away)
    monkeypatch.setattr(supervisor_module, "_STORAGE_TIMEOUT_S", 0.2)
    job = bench.run("succeeds")
    assert (job.status, job.attempts[0].reason) == (JobStatus.QUEUED, Reason.STORAGE_UNAVAILABLE)


@pytest.mark.extra
def test_what_ends_the_storing_does_not_pass_for_success(
    tmp_path: Path, job_store: PostgresJobStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Bench(tmp_path, job_store)

    def broken(*_: Any, **__: Any) -> None:
        raise ValueError("a mistake")

    monkeypatch.setattr(bench.objects, "put_stream", broken)
    job = bench.submit()
    with pytest.raises(ValueError, match="a mistake"):
        bench.supervisor(job, "succeeds").run()
    assert bench.store.get(job.id).status != JobStatus.SUCCEEDED
