"""What is prepared, with a training that is stood for by a short program."""

import json
import sys
from pathlib import Path

from structlog.testing import capture_logs

from core.settings import WorkerSettings
from tests.in_memory import MemoryObjectStore
from worker.compile_cache.fingerprint import fingerprint
from worker.preparation.programs import prepare

# Notes its task, and leaves a compiled program.
COMPILES = """
import os, pathlib, sys
spool = pathlib.Path(sys.argv[1])
(pathlib.Path(os.environ["GAITWAY_DATA_DIR"]) / "task.json").write_text((spool / "task.json").read_text())
(spool / "cache" / "compiled").mkdir(parents=True)
(spool / "cache" / "compiled" / "abc").write_text("code")
"""
FAILS = """
import os, sys
os.write(int(sys.argv[2]), b'{"type": "failed", "message": "No room."}\\n')
sys.exit(1)
"""


def run(program: str, settings: WorkerSettings) -> None:
    prepare("ant", settings, MemoryObjectStore(), "cpu", command=(sys.executable, "-c", program))


def test_what_a_short_training_compiles_is_kept_for_the_machine_and_once(settings: WorkerSettings) -> None:
    with capture_logs() as logs:
        run(COMPILES, settings)
        run(FAILS, settings)
    assert [line["event"] for line in logs if line["event"] != "caches_shared"] == ["prepared"]
    kept = settings.data_dir / "cache" / fingerprint("cpu") / "compiled" / "abc"
    assert kept.read_text() == "code"
    spec = json.loads((settings.data_dir / "task.json").read_text())["spec"]
    assert spec["environment"] == {"id": "ant"}
    assert spec["algorithm"] == {"num_timesteps": 1}
    assert left_in(settings.data_dir / "spool") == []


def test_a_failure_says_why_and_is_tried_again(settings: WorkerSettings) -> None:
    with capture_logs() as logs:
        run(FAILS, settings)
        run(COMPILES, settings)
    assert [line["event"] for line in logs if line["event"] != "caches_shared"] == [
        "not_prepared",
        "prepared",
    ]
    assert "No room." in logs[0]["detail"]


def left_in(folder: Path) -> list[Path]:
    return list(folder.glob("*"))
