"""The gallery has every environment: moving, or named as not trained yet; and its commands are accepted."""

import re
import shlex
from pathlib import Path

import mujoco
import pytest
from PIL import Image
from typer.testing import CliRunner

from bench.pictures import SHOWN as FILMED
from core.environments import catalog
from core.environments.terms.describe import inventory
from core.jobs.job import Job
from core.jobs.spec import JOB_SPEC
from core.jobs.store import JobQuery
from core.jobs.submission import completed
from gaitway.cli.main import app
from tests.api.conftest import Stack
from tests.api.test_models import DESCRIPTION, worker

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "gallery.md").read_text()
PICTURES = re.findall(r"!\[[^\]]*\]\(([^)]+)\)", PAGE)
# A picture, and below it the name of the body.
SHOWN = re.findall(r"!\[[^\]]*\]\(([^)]+)\)(?:<br>|\s)*\[\*\*([^*]+)\*\*\]", PAGE)
_, _, NOT_TRAINED = PAGE.partition("\n## Not trained here yet\n")
SHELL = "".join(re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL)).replace("\\\n", " ")
COMMANDS = [shlex.split(line) for line in SHELL.splitlines() if line]


def test_every_environment_is_shown_or_named_as_not_trained_yet() -> None:
    shown = {body for _, body in SHOWN}
    untrained = set(re.findall(r"`([^`]+)`", NOT_TRAINED))
    assert shown | untrained == set(catalog.ENVIRONMENTS)
    assert shown & untrained == set()


@pytest.mark.parametrize("picture", PICTURES)
def test_every_picture_moves(picture: str) -> None:
    with Image.open(ROOT / "docs" / picture) as image:
        assert getattr(image, "n_frames", 1) > 1


def test_every_job_is_accepted(stack: Stack, monkeypatch: pytest.MonkeyPatch) -> None:
    jobs = _submitted(stack, monkeypatch)
    submitted = [command for command in COMMANDS if command[:2] == ["gaitway", "submit"]]
    assert len(jobs) == len(submitted) > 0
    # Every body that is shown has a job, and every picture that can be made again is of a job on the page.
    assert {body for _, body in SHOWN} <= {job.spec.environment.id for job in jobs}
    sent = [job.spec.model_dump(exclude_unset=True) for job in jobs]
    for one in FILMED.values():
        wanted = completed(JOB_SPEC.validate_python({"kind": "train", **one.job}))
        assert wanted.model_dump(exclude_unset=True) in sent


def _submitted(stack: Stack, monkeypatch: pytest.MonkeyPatch) -> list[Job]:
    """The jobs that the page's commands leave in the record."""
    monkeypatch.chdir(ROOT)
    monkeypatch.setenv("GAITWAY_URL", str(stack.http.base_url))
    found = inventory(mujoco.MjModel.from_xml_path(str(ROOT / "examples" / "quadruped.xml")))
    with worker(stack, status="ready", description=DESCRIPTION.model_copy(update={"inventory": found})):
        for program, *arguments in COMMANDS:
            assert program == "gaitway"
            # Nothing runs the jobs here, so nobody may wait for one.
            given = [argument for argument in arguments if argument != "--watch"]
            result = CliRunner().invoke(app, given)
            assert (result.exit_code, result.exception) == (0, None), (given, result.output)
    return list(stack.store.list(JobQuery(), limit=100).jobs)
