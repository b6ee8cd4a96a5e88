"""Jobs without the service: what a cut one leaves, and the specifications that lie ready."""

import json
import time
from pathlib import Path

import pytest

from bench.run_job import Story, gpus
from core.algorithms.catalog import resolve
from core.environments import catalog
from core.jobs.spec import JOB_SPEC, TrainSpec
from worker.protocol import Measured, Started

READY = sorted((Path(__file__).parents[3] / "bench" / "jobs").glob("*.json"))


@pytest.mark.parametrize(
    ("visible", "number", "device"), [(None, 2, "gpu:0,1"), ("3", 1, "gpu:3"), ("2,5,6", 2, "gpu:2,5")]
)
def test_a_job_takes_the_cards_that_it_may_see(
    visible: str | None, number: int, device: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
    if visible is not None:
        monkeypatch.setenv("CUDA_VISIBLE_DEVICES", visible)
    assert gpus(number) == device


@pytest.mark.parametrize("visible", ["3", ""])
def test_fewer_visible_cards_than_asked_for_are_refused(
    visible: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", visible)
    with pytest.raises(SystemExit, match="2 are asked for"):
        gpus(2)


def test_a_job_that_is_cut_off_leaves_what_it_measured_until_then(tmp_path: Path) -> None:
    (tmp_path / "metrics.jsonl").write_text("of an earlier job\n")
    story = Story(tmp_path, began=time.perf_counter())
    story.take(Started(device="cpu", engine="native"))
    story.take(Measured(step=1, values={"training/v_loss": 2.0}))
    story.take(Measured(step=2, values={"eval/episode_reward": 3.0}))
    rows = [json.loads(line) for line in (tmp_path / "metrics.jsonl").read_text().splitlines()]
    assert [(row["step"], row["values"]) for row in rows] == [
        (1, {"training/v_loss": 2.0}),
        (2, {"eval/episode_reward": 3.0}),
    ]
    assert json.loads((tmp_path / "job.json").read_text())["engine"] == "native"


@pytest.mark.parametrize("path", READY, ids=lambda path: path.stem)
def test_a_job_that_lies_ready_would_be_accepted(path: Path) -> None:
    spec = JOB_SPEC.validate_json(path.read_bytes())
    assert isinstance(spec, TrainSpec)
    info = catalog.find(spec.environment.id)
    options = catalog.parse_options(info, spec.environment.options)
    settings = resolve(spec.algorithm, info.under(options), "gpu")
    assert settings.budget >= 10_000_000
