"""The real training process, told to go: it keeps what would be lost, and wastes no time on anything else."""

import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest

from core.jobs.spec import JOB_SPEC
from tests.faults.bench import SPEC
from worker.host.child import TRAINING, TrainingProcess
from worker.protocol import FileReady, Message, Task
from worker.stopping import DRAIN_SIGNAL, Stop

# To leave takes an epoch of a second and a file; this film alone is 1,800 frames, of more than 10 ms each.
LONG_FILM = {"width": 640, "height": 480, "fps": 30, "seconds": 60, "every_checkpoint": True}
SOON_S = 10.0

pytestmark = pytest.mark.usefixtures("compiled_quickly")


class Training:
    """A training process, and the messages that it has sent since somebody asked for them."""

    def __init__(self, folder: Path, data_dir: Path, **fields: Any) -> None:
        spool = folder / "spool"
        spool.mkdir()
        spec = JOB_SPEC.validate_python({**SPEC, "video": LONG_FILM, **fields})
        task = Task(job_id="0" * 12 + "-" + "0" * 10, attempt=1, spec=spec, device="cpu")
        (spool / "task.json").write_text(task.model_dump_json())
        lock = os.open(folder / "lock", os.O_RDWR | os.O_CREAT)
        self.process = TrainingProcess(TRAINING, spool, data_dir, "cpu", [lock])
        os.close(lock)
        self.said = list[str]()
        self._listener = threading.Thread(target=lambda: self.said.extend(self.process.lines()))
        self._listener.start()
        self.messages = self.process.messages()

    def until(self, kind: str) -> Message:
        for message in self.messages:
            if message.type == kind:
                return message
        pytest.fail(f"it ended without {kind}: {self.said}")

    def leave(self) -> tuple[list[FileReady], int, float]:
        """The files that it hands over after a drain, its exit status, and the seconds that it took to go."""
        asked = time.monotonic()
        self.process.stop(Stop.DRAIN)
        files = [message for message in self.messages if isinstance(message, FileReady)]
        status = self.process.poll(SOON_S)
        assert status is not None
        return files, status, time.monotonic() - asked

    def close(self) -> None:
        self.process.kill()
        self._listener.join()
        list(self.messages)


@pytest.fixture(scope="module")
def data_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where what one test has compiled is kept for the next."""
    return tmp_path_factory.mktemp("data")


@pytest.fixture
def training(tmp_path: Path, data_dir: Path) -> Iterator[Training]:
    training = Training(tmp_path, data_dir)
    yield training
    training.close()


def test_a_drain_in_the_middle_of_training_hands_over_a_checkpoint_and_nothing_else(
    training: Training,
) -> None:
    training.until("progress")
    files, status, took_s = training.leave()
    assert [file.role for file in files] == ["checkpoint"]
    assert (files[0].step or 0) > 0
    assert (status, took_s < SOON_S) == (-DRAIN_SIGNAL, True)


@pytest.mark.extra
def test_a_drain_before_the_first_update_ends_the_process_at_once(training: Training) -> None:
    training.until("started")  # From here on it compiles.
    files, status, took_s = training.leave()
    assert (files, status) == ([], -DRAIN_SIGNAL)
    assert took_s < 1


@pytest.mark.extra
def test_a_drain_ends_a_video_that_is_being_made(tmp_path: Path, data_dir: Path) -> None:
    training = Training(tmp_path, data_dir, checkpoints={"every_steps": 640})
    try:
        training.until("file")
        when_it_draws(training.process.pid)
        children = psutil.Process(training.process.pid).children()  # The path's picture is drawn beside it.
        files, status, took_s = training.leave()
        assert [file.role for file in files] == ["simulation", "export", "trajectory", "scene", "replay"]
        assert status == -DRAIN_SIGNAL
        assert took_s < 1
        assert not psutil.wait_procs(children, timeout=5)[1]
    finally:
        training.close()


def when_it_draws(pid: int) -> list[psutil.Process]:
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        children = psutil.Process(pid).children()
        found = [child for child in children if "worker.render.process" in child.cmdline()]
        if found:
            return found
        time.sleep(0.02)
    pytest.fail("it draws nothing")


@pytest.mark.extra
def test_the_process_stands_in_its_spool_and_finds_its_modules_there(training: Training) -> None:
    training.until("hello")
    assert psutil.Process(training.process.pid).cwd().endswith("/spool")
