"""The real preview and training processes cannot read the worker's secrets."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from core.jobs.spec import JOB_SPEC
from core.previews import library
from core.rendering.gl import probe
from core.settings import WorkerSettings
from core.storage import keys
from tests.in_memory import MemoryObjectStore
from tests.unit.worker.environments import environment
from tests.unit.worker.preview.test_preview import MODEL, request
from worker.confinement import landlock
from worker.host.child import TRAINING, TrainingProcess
from worker.preview.drawing import draw
from worker.protocol import Failed, Task

ROOT = Path(__file__).parents[4]
pytestmark = pytest.mark.skipif(not landlock.version(), reason="this kernel has no Landlock")

# Python runs it at the start of every process that finds it: at the process' end it tries what is asked.
_AT_THE_END = """
import atexit, json, os, tempfile
from pathlib import Path

def tried(what):
    try:
        what()
        return "done"
    except OSError as error:
        return type(error).__name__

def look():
    asked = json.loads(os.environ["ASKED"])
    if os.getpid() == os.getpgrp():  # Not its children.
        found = {path: tried(lambda: open(path).read()) for path in asked["read"]}
        found |= {path: tried(lambda: open(path, "w")) for path in asked["write"]}
        found["environment"] = tried(lambda: open(f"/proc/{os.getppid()}/environ").read())
        found["temporary"] = tried(lambda: tempfile.TemporaryFile().close())
        Path(asked["folder"], "found.json").write_text(json.dumps(found))

atexit.register(look)
"""


class Asked:
    """A data folder with a secret, and a question to the next process that starts in its spool."""

    def __init__(self, data: Path, patch: pytest.MonkeyPatch) -> None:
        self.data, self.spool, hooks = data, data / "spool", data.parent / "hooks"
        self.spool.mkdir(parents=True)
        hooks.mkdir()
        (hooks / "sitecustomize.py").write_text(_AT_THE_END)
        self.secret, self.kept = data / "keys.json", data / "checkpoint"
        self.secret.write_text("word")
        self.kept.write_text("work")
        asked = {
            "read": [str(self.secret), str(ROOT / "pyproject.toml"), "/proc/meminfo"],
            "write": [str(self.kept), str(self.spool / "mine")],
            "folder": str(self.spool),
        }
        patch.setenv("ASKED", json.dumps(asked))
        patch.setenv("PYTHONPATH", str(hooks))
        patch.setenv("MUJOCO_GL", probe()[0])

    def found(self) -> dict[str, Any]:
        """The result of each read and write, by its path."""
        return json.loads((self.spool / "found.json").read_text())

    def check(self) -> None:
        found = self.found()
        assert [found.pop(str(path)) for path in ("/proc/meminfo", self.spool / "mine")] == ["done"] * 2
        assert found.pop("temporary") == "done"
        assert set(found.values()) == {"PermissionError"}, found
        assert self.kept.read_text() == "work"


@pytest.fixture
def asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Asked:
    return Asked(tmp_path / "data", monkeypatch)


@pytest.mark.extra
def test_a_preview_reads_no_secret_of_the_worker(asked: Asked) -> None:
    objects = MemoryObjectStore()
    objects.put(keys.model_source(request().model or ""), MODEL)
    draw(request(), objects, asked.spool, asked.data)
    found = library.find(request(), objects)
    assert found is not None
    assert found.failure is None, found.failure
    asked.check()


def rolled_out(asked: Asked, *, model: bool) -> list[str]:
    """A rollout with its video, by the real process; the names of its files."""
    environment: dict[str, Any] = {"id": "inverted_pendulum"}
    if model:
        (asked.spool / "model").write_bytes(MODEL)
        environment = {"id": "mjcf", "options": request().options}
    spec = JOB_SPEC.validate_python(
        {
            "kind": "rollout",
            "environment": environment,
            "policy": {"kind": "zero"},
            "num_steps": 10,
            "video": {"width": 64, "height": 48, "seconds": 0.2},
        }
    )
    task = Task(job_id="j", attempt=1, spec=spec, device="cpu", model="model" if model else None)
    (asked.spool / "task.json").write_text(task.model_dump_json())
    (asked.spool / "cache").mkdir()
    process = TrainingProcess(TRAINING, asked.spool, asked.data, "cpu", ())
    messages = list(process.messages())
    lines = list(process.lines())
    assert process.poll(10) == 0, [lines, [m for m in messages if isinstance(m, Failed)]]
    return [message.name for message in messages if message.type == "file"]


@pytest.mark.timeout(300)  # JAX is started and compiles.
def test_a_training_process_with_a_users_model_reads_no_secret_of_the_worker(asked: Asked) -> None:
    files = rolled_out(asked, model=True)
    asked.check()
    assert "video.mp4" in files
    assert list((asked.spool / "cache" / "jax").iterdir())


@pytest.mark.extra
def test_a_worker_that_confines_no_models_lets_them_be(
    asked: Asked, settings: WorkerSettings, tmp_path: Path
) -> None:
    secrets = tmp_path / "secrets"
    secrets.mkdir()
    (secrets / "gaitway_models").write_text("unconfined")
    program = "import sys; from worker.tasks import draw_preview; draw_preview(sys.argv[1])"
    unknown = request(model=None, environment="no such").model_dump_json()
    subprocess.run(
        [sys.executable, "-c", program, unknown],
        cwd=ROOT,
        env=environment(settings, GAITWAY_SECRETS_DIR=str(secrets)),
        check=True,
    )
    assert asked.found()[str(asked.secret)] == "done"


def test_a_system_that_refuses_is_done_without_and_says_so(tmp_path: Path) -> None:
    program = (
        "import sys; from pathlib import Path\n"
        "from worker.confinement import landlock, own_files\n"
        "landlock._CREATE_RULESET = 100_000; landlock.version = lambda: 7\n"
        "print(own_files.keep_to_own_files(Path(sys.argv[1])), open('pyproject.toml').read(1))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, str(tmp_path)],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "False [\n"
    assert "could not be kept to its own files" in done.stderr
