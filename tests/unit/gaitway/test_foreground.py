"""`gaitway run`: a training in this process, without a service."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from gaitway.cli.main import app
from gaitway.service import foreground

JOB: dict[str, Any] = {
    "environment": "inverted_pendulum",
    "physics": "native",
    "video": None,
    "algorithm": {
        "kind": "ppo",
        "num_timesteps": 320,
        "num_envs": 8,
        "batch_size": 8,
        "num_minibatches": 2,
        "unroll_length": 5,
        "num_evals": 1,
        "num_eval_envs": 2,
        "episode_length": 20,
        "policy_hidden_layer_sizes": [4],
        "value_hidden_layer_sizes": [4],
    },
}


GAITWAY = [sys.executable, "-c", "from gaitway.cli.main import app; app()"]


@pytest.fixture
def job(tmp_path: Path) -> Path:
    path = tmp_path / "pendulum.json"
    path.write_text(json.dumps(JOB))
    return path


def trained(folder: Path, *arguments: str, command: str = "run", interrupt: bool = False) -> tuple[int, str]:
    """The exit status and the output of `gaitway run`, or of another command in this folder.

    interrupt: by Ctrl-C at the first progress.
    """
    with subprocess.Popen(
        [*GAITWAY, command, *arguments],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as process:
        lines = list[str]()
        for line in process.stdout or ():
            lines.append(line)
            if interrupt and " steps" in line:
                process.send_signal(signal.SIGINT)
                interrupt = False
    return process.returncode, "".join(lines)


@pytest.mark.extra
@pytest.mark.timeout(300)
def test_ctrl_c_ends_a_training_with_a_checkpoint_from_which_it_goes_on(job: Path, tmp_path: Path) -> None:
    endless = ("--set", "algorithm.num_timesteps=1000000000")
    status, printed = trained(tmp_path, str(job), *endless, interrupt=True)
    assert status == 130, printed
    assert "native on cpu" in printed
    folder = tmp_path / "gaitway-run" / "pendulum"
    [kept] = folder.glob("checkpoint-*.msgpack")
    step = int(kept.stem.rpartition("-")[2])
    end = step + 320

    again = ("--resume", str(kept), "--set", f"algorithm.num_timesteps={end}")
    status, printed = trained(tmp_path, str(job), *again)
    assert status == 0, printed
    assert f"{end:,}/{end:,} steps" in printed
    assert {"policy", "policy.npz", "started.json"} <= {path.name for path in folder.iterdir()}
    rows = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    assert rows[0]["step"] <= step < rows[-1]["step"] == end
    assert "eval/episode_reward" in rows[-1]["values"]


def refused(job: Path) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["run", str(job)])
    return result.exit_code, result.output


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"seed": "zero"}, "seed"),
        ({"kind": "rollout", "policy": {"kind": "random"}}, "A rollout needs a service"),
        ({"resume_from": {"job": "018bcfe56800-0123456789"}}, "--resume CHECKPOINT"),
    ],
)
def test_what_only_a_service_takes_is_refused(job: Path, changed: dict[str, Any], sentence: str) -> None:
    document = {**JOB, **changed}
    if "kind" in changed:
        del document["algorithm"]
    job.write_text(json.dumps(document))
    status, printed = refused(job)
    assert (status, sentence in printed) == (2, True), printed


def test_a_missing_package_is_named(job: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def find_spec(name: str) -> str | None:
        return None if name == "mujoco" else name

    monkeypatch.setattr("importlib.util.find_spec", find_spec)
    status, printed = refused(job)
    assert status == 2
    assert "mujoco is not installed" in printed


@pytest.mark.parametrize(
    ("visible", "gpus", "device"), [(None, 2, "gpu:0,1"), ("3", 1, "gpu:3"), ("2,5,6", 2, "gpu:2,5")]
)
def test_a_job_takes_the_cards_that_it_may_see(
    visible: str | None, gpus: int, device: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
    if visible is not None:
        monkeypatch.setenv("CUDA_VISIBLE_DEVICES", visible)
    assert foreground.device_of(gpus) == device


@pytest.mark.parametrize("visible", ["3", ""])
def test_fewer_visible_cards_than_asked_for_are_refused(
    visible: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", visible)
    with pytest.raises(foreground.Rejected, match="--gpus asks for 2"):
        foreground.device_of(2)
