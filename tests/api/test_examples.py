"""The examples' jobs are what the service takes."""

import json
import runpy
from pathlib import Path
from typing import Any

import dm_control
import mujoco
import pytest

from core.environments.terms.describe import inventory
from tests.api import test_clips
from tests.api.conftest import Stack
from tests.api.test_models import DESCRIPTION, worker

FOLDER = Path(__file__).parents[2] / "examples"
RAT = "locomotion/walkers/assets/rodent.xml"
# One drives a robot and one draws a recording: they send no job.
EXAMPLES = sorted(set(FOLDER.glob("*.py")) - {FOLDER / "deploy.py", FOLDER / "plot_recording.py"})
EXERCISES = sorted(FOLDER.glob("exercises/*.json"))
# One is of a model that lies beside it, and one of a model and clips that users have.
QUADRUPED, TRACK_MJX = FOLDER / "quadruped.json", FOLDER / "track_mjx.json"
JOBS = sorted(set(FOLDER.glob("*.json")) - {QUADRUPED, TRACK_MJX})


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


def test_the_job_by_the_settings_of_track_mjx_is_one_of_a_rat_with_a_free_joint(stack: Stack) -> None:
    spec = mujoco.MjSpec.from_file(str(Path(dm_control.__file__).parent / RAT))
    spec.body("torso").add_freejoint(name="root")
    found = inventory(spec.compile())
    with worker(stack, status="ready", description=DESCRIPTION.model_copy(update={"inventory": found})):
        model = stack.http.post("/models", content=b"<mujoco/>", headers={"content-type": "application/xml"})
    assert model.status_code == 201, model.text
    joints = [joint.name for joint in found.moving_joints()]
    described = test_clips.DESCRIPTION.model_copy(update={"joints": joints})
    with test_clips.worker(stack, status="ready", description=described):
        clips = test_clips.send(stack.http, body=model.json()["id"], rate=50)
    assert clips.status_code == 201, clips.text
    job = json.loads(TRACK_MJX.read_text())
    options = job["environment"]["options"]
    options["model"], options["reference"]["clips"][0]["file"] = model.json()["id"], clips.json()["id"]
    answer = stack.http.post("/jobs", json=job)
    assert answer.status_code == 202, answer.text
    # Its kernels exp(-0.25 Σ) over 67 joints and exp(-500 Σ) over 5 bodies, as kernels of means.
    joint, end = (options["reward"][place]["tolerance"] for place in (2, 3))
    assert (len(joints), joint, end) == (67, pytest.approx((0.25 * 67) ** -0.5, abs=1e-3), (500 * 5) ** -0.5)
