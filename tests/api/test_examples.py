"""The examples' jobs are what the service takes."""

import json
import runpy
from pathlib import Path
from typing import Any

import mujoco
import pytest

from core.environments.terms.describe import inventory
from tests.api.conftest import Stack
from tests.api.test_models import DESCRIPTION, worker

FOLDER = Path(__file__).parents[2] / "examples"
# One drives a robot and one draws a recording: they send no job.
EXAMPLES = sorted(set(FOLDER.glob("*.py")) - {FOLDER / "deploy.py", FOLDER / "plot_recording.py"})
EXERCISES = sorted(FOLDER.glob("exercises/*.json"))
# One is of a model that lies beside it.
QUADRUPED = FOLDER / "quadruped.json"
JOBS = sorted(set(FOLDER.glob("*.json")) - {QUADRUPED})


@pytest.mark.parametrize("path", EXAMPLES, ids=[path.stem for path in EXAMPLES])
def test_an_examples_job_is_accepted(stack: Stack, path: Path) -> None:
    names: dict[str, Any] = runpy.run_path(str(path))
    answer = stack.http.post("/jobs", json=names["JOB"])
    assert answer.status_code == 202, answer.text


@pytest.mark.parametrize("path", EXERCISES, ids=[path.stem for path in EXERCISES])
def test_an_exercise_is_accepted_and_its_result_is_told(stack: Stack, path: Path) -> None:
    answer = stack.http.post("/jobs", json=json.loads(path.read_text()))
    assert answer.status_code == 202, answer.text
    assert (
        f"[{path.stem}](../examples/exercises/{path.name})"
        in (FOLDER.parent / "docs/q_learning.md").read_text()
    )


@pytest.mark.parametrize("path", JOBS, ids=[path.stem for path in JOBS])
def test_a_job_that_lies_beside_them_is_accepted(stack: Stack, path: Path) -> None:
    answer = stack.http.post("/jobs", content=path.read_bytes(), headers={"content-type": "application/json"})
    assert answer.status_code == 202, answer.text


def test_a_job_of_a_model_beside_them_is_accepted_once_the_model_is_there(stack: Stack) -> None:
    model = QUADRUPED.with_suffix(".xml")
    found = inventory(mujoco.MjModel.from_xml_path(str(model)))
    with worker(stack, status="ready", description=DESCRIPTION.model_copy(update={"inventory": found})):
        sent = stack.http.post(
            "/models", content=model.read_bytes(), headers={"content-type": "application/xml"}
        )
    assert sent.status_code == 201, sent.text
    test_a_job_that_lies_beside_them_is_accepted(stack, QUADRUPED)
